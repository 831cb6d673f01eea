"""Commands on recorded volumes: track a needle through them, locate it in one."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from sonoservo.diagrams.app.options import (
    DepthOption,
    DynamicRangeOption,
    HostOption,
    JsonOption,
    OrderOption,
    PosesOption,
    RateOption,
    WindowOption,
    console,
    write_printed,
)


def track_command(
    recording: Annotated[
        Path, typer.Argument(help="Recorded volumes: .seq.nrrd, .nrrd, .nhdr, .mha or .mhd.")
    ],
    tracker: Annotated[str, typer.Option(help="chatelain2013 or zhao2012.")] = "chatelain2013",
    order: OrderOption = 2,
    start: Annotated[
        str,
        typer.Option(help="search: wait until it is pushed in; anywhere: look in whole volumes."),
    ] = "search",
    depth: DepthOption = "P",
    window: WindowOption = None,
    dynamic_range_db: DynamicRangeOption = None,
    volume_rate: RateOption = None,
    poses: PosesOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed; by default the recorder's.")] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="No faster than it was recorded.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--show", help="Show the volumes in a browser, as a scanner does.")
    ] = False,
    host: HostOption = "localhost",
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    json_path: JsonOption = None,
) -> None:
    """Track a needle through recorded volumes; end with a folder of results."""
    from sonoservo.diagrams.app.terminal import (
        VolumeProgress,
        keep_shown,
        mode_table,
        start_monitor,
    )
    from sonoservo.diagrams.app.track import track_recording, tracker_parameters
    from sonoservo.systems.recording.recording import Recording

    parameters = tracker_parameters(tracker, order=order, start=start)
    opened = Recording(
        recording,
        depth=depth,
        window=window,
        dynamic_range_db=dynamic_range_db,
        volume_rate=volume_rate,
        poses=poses,
    )
    folder = out or Path("out") / f"{recording.name.partition('.')[0]}_track"
    monitor = start_monitor(console, host) if show else None
    with VolumeProgress(console, recording.name, len(opened)) as progress:
        result = track_recording(
            opened,
            parameters=parameters,
            seed=seed,
            real_time=real_time,
            monitor=monitor,
            out=folder,
            command=shlex.join(["sonoservo", *sys.argv[1:]]),
            after_volume=progress,
        )
    console.print(mode_table(result.summary))
    console.print(f"Results, starting with the report: {folder / 'report.html'}", soft_wrap=True)
    write_printed(json_path, result.summary)
    if monitor is not None and not result.summary["interrupted"]:
        keep_shown(console)
    if result.summary["interrupted"]:
        raise typer.Exit(130)


def locate_command(
    volume: Annotated[Path, typer.Argument(help="A volume: .nrrd, .nhdr, .mha or .mhd.")],
    number: Annotated[int, typer.Option(help="Which volume, if the file has several.")] = 0,
    order: OrderOption = 2,
    depth: DepthOption = "P",
    window: WindowOption = None,
    dynamic_range_db: DynamicRangeOption = None,
    json_path: JsonOption = None,
) -> None:
    """Find the needle in one volume, in the file's coordinates; exit code 1 if there is none."""
    import numpy as np

    from sonoservo.diagrams.app.locate import locate_in_recording
    from sonoservo.systems.recording.recording import Recording

    # Neither times nor poses matter for a single volume.
    opened = Recording(
        volume,
        depth=depth,
        window=window,
        dynamic_range_db=dynamic_range_db,
        volume_rate=1.0,
        poses="none",
    )
    found = locate_in_recording(opened, number, order=order)
    for name, value in found.items():
        shown = np.round(value, 3).tolist() if isinstance(value, list | float) else value
        console.print(f"{name}: {shown}", soft_wrap=True, highlight=False)
    write_printed(json_path, found)
    if not found["found"]:
        raise typer.Exit(1)
