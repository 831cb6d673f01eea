"""Commands on recorded and live volumes: check, track, bridge, locate and calibrate."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sonoservo.diagrams.app.interruption import INTERRUPTED
from sonoservo.diagrams.app.options import (
    BeamWidthOption,
    CalibrationOption,
    ClockOffsetOption,
    DepthOption,
    DynamicRangeOption,
    EchoOffsetOption,
    ExplainOption,
    FramesOption,
    HostOption,
    JsonOption,
    LuminanceOption,
    MotorOption,
    OpenOption,
    OrderOption,
    OutOption,
    PatienceOption,
    PlusConfigOption,
    PosesOption,
    RateOption,
    ReconstructOption,
    SpacingOption,
    VoidOption,
    VolumesOption,
    WaitOption,
    WindowOption,
    console,
    say_notes,
    say_report,
    write_printed,
)
from sonoservo.systems.files.refusals import ConfigurationError

if TYPE_CHECKING:
    from sonoservo.diagrams.app.volumes.reconstruct import ReconstructedRecording
    from sonoservo.systems.recording.recording import Recording


def track_command(
    source: Annotated[
        str,
        typer.Argument(
            help="Recorded volumes: .seq.nrrd, .nrrd, .nhdr, .mha, .mhd or .hdf5, or frames (also "
            ".dcm, .h5, a folder of PNG) with --reconstruct; or live ones: "
            "igtl://host:18944/DEVICE, or igtl://:18944 to wait for a scanner to connect."
        ),
    ],
    tracker: Annotated[
        str, typer.Option(help="Name of a tracker, such as chatelain2013 or zhao2012.")
    ] = "chatelain2013",
    order: OrderOption = 2,
    start: Annotated[
        str,
        typer.Option(help="search: wait for an insertion; anywhere: look in whole volumes."),
    ] = "search",
    depth: DepthOption = "P",
    window: WindowOption = None,
    dynamic_range_db: DynamicRangeOption = None,
    volume_rate: RateOption = None,
    poses: PosesOption = None,
    plus_config: PlusConfigOption = None,
    calibration: CalibrationOption = None,
    void: VoidOption = None,
    luminance: LuminanceOption = False,
    beam_width: BeamWidthOption = None,
    echo_offset: EchoOffsetOption = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Random seed; by default, the recorder's.")
    ] = None,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Limit the pace to that of the recording.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--show", help="Show the volumes in a browser, as a scanner does.")
    ] = False,
    host: HostOption = "localhost",
    open_page: OpenOption = True,
    reconstruct: ReconstructOption = False,
    motor: MotorOption = None,
    frames: FramesOption = None,
    spacing: SpacingOption = 0.7,
    serve: Annotated[
        list[str] | None,
        typer.Option(help="Live: address to send estimates to; the source's own is allowed."),
    ] = None,
    names: Annotated[
        list[str] | None,
        typer.Option("--name", help="Live: device names: tip=, curve=, status=, covariance=."),
    ] = None,
    points: Annotated[
        bool, typer.Option("--points", help="Live: send control points (POINT) in place of a line.")
    ] = False,
    clock_offset: ClockOffsetOption = None,
    volumes: VolumesOption = None,
    patience: PatienceOption = None,
    explain: ExplainOption = False,
    correct_poses: Annotated[
        bool,
        typer.Option(
            "--correct-poses",
            help="Correct the delay and the calibration of the poses; see calibrate.",
        ),
    ] = False,
    out: OutOption = None,
    json_path: JsonOption = None,
) -> None:
    """Track a needle through recorded or live volumes, and write a folder of results."""
    from sonoservo.diagrams.app.live.commands import (
        make_maker,
        needle_names,
        only_for_files,
        track_address,
    )
    from sonoservo.diagrams.app.live.track_live import LiveLimits
    from sonoservo.diagrams.app.terminal import (
        VolumeProgress,
        mode_table,
        mode_words,
        reasons_lines,
    )
    from sonoservo.diagrams.app.volumes.opening import open_volumes
    from sonoservo.diagrams.app.volumes.track import track_recording, tracker_parameters
    from sonoservo.systems.live.connection.protocols import is_address

    parameters = tracker_parameters(
        tracker,
        order=order,
        start=start,
        beam_width=_metres(beam_width),
        echo_offset=_metres(echo_offset),
    )
    pages = None
    if show:
        from sonoservo.diagrams.app.pages.pages import open_pages

        title = source if is_address(source) else Path(source).name
        pages = open_pages(console, title, host=host, world=False, by_itself=open_page)
    if is_address(source):
        only_for_files(
            plus_config=plus_config, calibration=calibration, void=void, luminance=luminance
        )
        if explain:
            raise ConfigurationError(
                "explain: not possible with live volumes; record them (sonoservo bridge), "
                "and track the recording with --explain"
            )
        maker = make_maker(
            depth=depth,
            window=window,
            dynamic_range_db=dynamic_range_db,
            reconstruct=reconstruct,
            motor=motor,
            frames=frames,
            spacing=1e-3 * spacing,
        )
        summary = track_address(
            console,
            source,
            parameters=parameters,
            maker=maker,
            poses=poses,
            clock_offset=clock_offset,
            seed=seed,
            page=pages.console if pages else None,
            serve=serve or [],
            names=needle_names(names or [], points=points),
            limits=LiveLimits(volumes=volumes, patience=patience),
            correct_poses=correct_poses,
            out=out,
        )
        write_printed(json_path, summary)
        if pages:
            pages.end(console, mode_words(summary))
        return
    recording = Path(source)
    opened = open_volumes(
        recording,
        reconstruct=reconstruct,
        depth=depth,
        window=window,
        dynamic_range_db=dynamic_range_db,
        volume_rate=volume_rate,
        poses=poses,
        frames=frames,
        spacing=1e-3 * spacing,
        plus_config=plus_config,
        calibration=calibration,
        void=void,
        luminance=luminance,
    )
    say_notes(*opened.notes)
    _say_gravest(opened)
    folder = out or Path("out") / f"{recording.name.partition('.')[0]}_track"
    with VolumeProgress(console, recording.name, len(opened)) as progress:
        result = track_recording(
            opened,
            parameters=parameters,
            seed=seed,
            real_time=real_time,
            console=pages.console if pages else None,
            out=folder,
            explain=explain,
            correct_poses=correct_poses,
            command=shlex.join(["sonoservo", *sys.argv[1:]]),
            after_volume=progress,
        )
    console.print(mode_table(result.summary))
    for line in reasons_lines(result.summary):
        console.print(line, soft_wrap=True)
    say_report(folder)
    write_printed(json_path, result.summary)
    if result.failure is not None:
        raise result.failure
    if pages:
        pages.end(console, mode_words(result.summary), folder / "report.html")
    if result.summary["interrupted"]:
        raise typer.Exit(INTERRUPTED)


def bridge_command(
    source: Annotated[str, typer.Argument(help="Address to record from, or a recording to play.")],
    target: Annotated[
        str, typer.Argument(help="NAME.seq.nrrd or NAME.hdf5 to record to, or address to play to.")
    ],
    depth: DepthOption = "P",
    window: WindowOption = None,
    dynamic_range_db: DynamicRangeOption = None,
    poses: PosesOption = None,
    plus_config: PlusConfigOption = None,
    calibration: CalibrationOption = None,
    void: VoidOption = None,
    luminance: LuminanceOption = False,
    reconstruct: ReconstructOption = False,
    motor: MotorOption = None,
    frames: FramesOption = None,
    spacing: SpacingOption = 0.7,
    speed: Annotated[
        float, typer.Option(help="Playing speed; 0 for as fast as the slowest peer accepts.")
    ] = 1.0,
    wait_for: WaitOption = 1,
    clock_offset: ClockOffsetOption = None,
    volumes: VolumesOption = None,
    patience: PatienceOption = None,
    json_path: JsonOption = None,
) -> None:
    """Record a live connection, or play a recording as a scanner would."""
    from sonoservo.diagrams.app.live.commands import bridge_files
    from sonoservo.diagrams.app.live.track_live import LiveLimits

    summary = bridge_files(
        console,
        source,
        target,
        depth=depth,
        window=window,
        dynamic_range_db=dynamic_range_db,
        reconstruct=reconstruct,
        motor=motor,
        frames=frames,
        spacing=1e-3 * spacing,
        poses=poses,
        clock_offset=clock_offset,
        speed=speed,
        wait_for=wait_for,
        limits=LiveLimits(volumes=volumes, patience=patience),
    )
    write_printed(json_path, summary)
    if summary["interrupted"]:
        raise typer.Exit(INTERRUPTED)


def locate_command(
    volume: Annotated[
        Path,
        typer.Argument(
            help="File with the volume: .nrrd, .nhdr, .mha, .mhd or .hdf5; see --reconstruct."
        ),
    ],
    number: Annotated[
        int, typer.Option(help="Number of the volume, from 0, if the file has several.")
    ] = 0,
    order: OrderOption = 2,
    depth: DepthOption = "P",
    window: WindowOption = None,
    dynamic_range_db: DynamicRangeOption = None,
    beam_width: BeamWidthOption = None,
    echo_offset: EchoOffsetOption = None,
    reconstruct: ReconstructOption = False,
    frames: FramesOption = None,
    spacing: SpacingOption = 0.7,
    volume_rate: RateOption = None,
    poses: PosesOption = None,
    plus_config: PlusConfigOption = None,
    calibration: CalibrationOption = None,
    void: VoidOption = None,
    luminance: LuminanceOption = False,
    json_path: JsonOption = None,
) -> None:
    """Find the needle in one volume, in the file's coordinates; exit with 1 if there is none."""
    import numpy as np

    from sonoservo.diagrams.app.volumes.locate import locate_in_recording
    from sonoservo.diagrams.app.volumes.opening import open_volumes
    from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters

    try:
        parameters = NeedleLocalizerParameters().knowing(
            beam_width=_metres(beam_width), echo_offset=_metres(echo_offset)
        )
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    # Times and poses do not matter for a single volume, unless it is made of frames.
    opened = open_volumes(
        volume,
        reconstruct=reconstruct,
        depth=depth,
        window=window,
        dynamic_range_db=dynamic_range_db,
        volume_rate=volume_rate if reconstruct else 1.0,
        poses=poses if reconstruct else "none",
        frames=frames,
        spacing=1e-3 * spacing,
        plus_config=plus_config,
        calibration=calibration,
        void=void,
        luminance=luminance,
    )
    say_notes(*opened.notes)
    _say_gravest(opened)
    found = locate_in_recording(opened, number, order=order, parameters=parameters)
    for name, value in found.items():
        shown = np.round(value, 3).tolist() if isinstance(value, list | float) else value
        console.print(f"{name}: {shown}", soft_wrap=True, highlight=False)
    write_printed(json_path, found)
    if not found["found"]:
        raise typer.Exit(1)
    say_notes(
        "one volume cannot tell a guide wire or another needle from it; `track` does by motion"
    )


def check_command(
    source: Annotated[
        str,
        typer.Argument(
            help="File of volumes or frames, PLUS's configuration (.xml), or a stream: "
            "igtl://host:18944/DEVICE, or igtl://:18944 to wait for a scanner to connect."
        ),
    ],
    depth: DepthOption = "P",
    window: WindowOption = None,
    volume_rate: RateOption = None,
    poses: PosesOption = None,
    plus_config: PlusConfigOption = None,
    calibration: CalibrationOption = None,
    void: VoidOption = None,
    luminance: LuminanceOption = False,
    clock_offset: ClockOffsetOption = None,
    seconds: Annotated[
        float, typer.Option(min=0.5, help="Live: time to listen after the first message, in s.")
    ] = 5.0,
    patience: PatienceOption = 30.0,
    out: OutOption = None,
    json_path: JsonOption = None,
) -> None:
    """Say what is in a file or a stream, and what is wrong with it; exit with 1 if something is.

    A picture marks where the probe is taken to be, and which way is up.
    """
    from sonoservo.diagrams.app.live.commands import only_for_files
    from sonoservo.diagrams.app.terminal import findings_table
    from sonoservo.diagrams.app.volumes.check import check_file, check_stream
    from sonoservo.systems.evaluation.reports.plots import png
    from sonoservo.systems.files.writing import write_atomically
    from sonoservo.systems.live.connection.protocols import is_address, parse_address

    options: dict[str, Any] = {"depth": depth, "window": window, "poses": poses}
    reading: dict[str, Any] = {
        "plus_config": plus_config,
        "calibration": calibration,
        "void": void,
        "luminance": luminance,
    }
    if is_address(source):
        only_for_files(**reading)
        address = parse_address(source)
        name = f"{address.host.replace(':', '_') or 'localhost'}_{address.port}"
        checked = check_stream(
            address,
            **options,
            clock_offset=clock_offset,
            seconds=seconds,
            patience=patience or 30.0,
            say=lambda line: console.print(line, soft_wrap=True),
        )
    else:
        name = Path(source).name.partition(".")[0]
        with console.status("looking at the volumes"):
            checked = check_file(Path(source), **options, volume_rate=volume_rate, **reading)
    console.print(findings_table(checked.findings))
    if checked.picture is not None:
        path = (out or Path("out") / f"{name}_check") / "orientation.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, png(checked.picture))
        console.print(f"Picture: {path}", soft_wrap=True)
    write_printed(json_path, checked.figures())
    if checked.gravest is not None:
        raise typer.Exit(1)


def calibrate_command(
    recording: Annotated[Path, typer.Argument(help="Recorded volumes with poses, as for track.")],
    depth: DepthOption = "P",
    window: WindowOption = None,
    dynamic_range_db: DynamicRangeOption = None,
    volume_rate: RateOption = None,
    poses: PosesOption = None,
    plus_config: PlusConfigOption = None,
    calibration: CalibrationOption = None,
    void: VoidOption = None,
    luminance: LuminanceOption = False,
    json_path: JsonOption = None,
) -> None:
    """Report delay and calibration error of a recording's poses; exit with 1 if they are unknown.

    The tissue must stand still while the probe moves.
    """
    from sonoservo.diagrams.app.terminal import VolumeProgress, pose_error_table
    from sonoservo.diagrams.app.volumes.calibrate import calibrate_recording, pose_error_figures
    from sonoservo.diagrams.app.volumes.opening import open_volumes

    opened = open_volumes(
        recording,
        depth=depth,
        window=window,
        dynamic_range_db=dynamic_range_db,
        volume_rate=volume_rate,
        poses=poses,
        plus_config=plus_config,
        calibration=calibration,
        void=void,
        luminance=luminance,
    )
    say_notes(*opened.notes)
    with VolumeProgress(console, recording.name, len(opened)) as progress:
        figures = pose_error_figures(calibrate_recording(opened, after_volume=progress))
    console.print(pose_error_table(figures) if figures["found"] else figures["reason"])
    write_printed(json_path, figures)
    if not figures["found"]:
        raise typer.Exit(1)


def _say_gravest(opened: "Recording | ReconstructedRecording") -> None:
    from sonoservo.diagrams.app.volumes.check import brief_finding

    if line := brief_finding(opened):
        console.print(line, style="yellow", soft_wrap=True)


def _metres(millimetres: float | None) -> float | None:
    """Return a length in m of one in mm; None if it is unknown."""
    return None if millimetres is None else 1e-3 * millimetres
