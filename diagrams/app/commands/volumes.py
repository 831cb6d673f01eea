"""Commands on recorded and live volumes: check, track, bridge, locate and calibrate."""

import shlex
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sonoservo.diagrams.app.interruption import INTERRUPTED
from sonoservo.diagrams.app.options import (
    Curve,
    ExplainOption,
    Listening,
    LiveLimits,
    LogOption,
    Page,
    Printed,
    Reading,
    ReadingFrames,
    Results,
    Sending,
    Tracker,
    WaitOption,
    console,
    free_folder,
    refuse_for_files,
    refuse_given,
    refusing_values,
    say,
    say_notes,
    say_report,
    write_printed,
)
from sonoservo.systems.files.counting import counted
from sonoservo.systems.files.refusals import ConfigurationError

if TYPE_CHECKING:
    from collections.abc import Callable

    from sonoservo.diagrams.app.pages.pages import Pages
    from sonoservo.diagrams.app.volumes.opening import Opened
    from sonoservo.systems.signals.needle_estimate import NeedleEstimate


def track_command(
    source: Annotated[
        str,
        typer.Argument(
            help="Recorded volumes: .seq.nrrd, .nrrd, .nhdr, .mha, .mhd, .nii, .hdf5, a folder "
            "with a file for each; or frames (also .dcm, .h5, a folder of PNG) with --reconstruct; "
            "or live ones: "
            "igtl://host:18944/DEVICE, or igtl://:18944 to wait for a scanner to connect."
        ),
    ],
    tracker: Tracker,
    reading: ReadingFrames,
    sending: Sending,
    limits: LiveLimits,
    page: Page,
    results: Results,
    show: Annotated[
        bool, typer.Option("--show", help="Show the volumes in a browser, as a scanner does.")
    ] = False,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="Limit the pace to that of the recording.")
    ] = False,
    explain: ExplainOption = False,
    log: LogOption = None,
) -> None:
    """Track a needle through recorded or live volumes, and write a folder of results."""
    from sonoservo.diagrams.app.own_tracker import is_factory
    from sonoservo.diagrams.app.volumes.track import tracker_parameters
    from sonoservo.systems.live.connection.address import is_address

    live = is_address(source)
    chosen: dict[str, Any]
    if is_factory(own := tracker.tracker):
        if tracker != Tracker(tracker=own):
            raise ConfigurationError(
                f"--tracker {own}: a tracker of your own is made without arguments; leave out the "
                "other options of trackers, such as --start"
            )
        chosen = {"tracker": own}
    else:
        parameters = tracker_parameters(
            tracker.tracker,
            order=tracker.order,
            start=tracker.start,
            beam_width=tracker.beam_width,
            echo_offset=tracker.echo_offset,
        )
        chosen = {"parameters": parameters}

    def open_page(title: str) -> "Pages | None":
        """Open the page if it is wanted, once it is known that there is something to show."""
        if not show:
            return None
        from sonoservo.diagrams.app.pages.pages import open_pages

        pages = open_pages(title, page, world=False)
        pages.announce(console)
        return pages

    if live:
        reading.refuse_for_streams()
        for option, given in (("--log", log), ("--explain", explain), ("--real-time", real_time)):
            if given:
                raise ConfigurationError(
                    f"{option}: not possible with live volumes; record them (sonoservo bridge), "
                    f"and track the recording with {option}"
                )
        _track_stream(source, tracker, chosen, reading, sending, limits, results, open_page)
    else:
        reading.refuse_for_files()
        refuse_for_files(sending, limits)
        _track_file(Path(source), tracker, chosen, reading, results, open_page, explain=explain,
                    real_time=real_time, log=log)  # fmt: skip


def _track_stream(
    address: str,
    tracker: Tracker,
    chosen: dict[str, Any],
    reading: ReadingFrames,
    sending: Sending,
    limits: LiveLimits,
    results: Results,
    open_page: "Callable[[str], Pages | None]",
) -> None:
    from sonoservo.diagrams.app.live.serve import needle_names, opened
    from sonoservo.diagrams.app.live.track_live import track_live
    from sonoservo.diagrams.app.terminal import live_table, mode_words
    from sonoservo.diagrams.app.volumes.check import brief_stream_finding
    from sonoservo.diagrams.app.volumes.opening import live_source
    from sonoservo.systems.evaluation.reports.verdict import found_words, pose_lines, reasons_lines
    from sonoservo.systems.live.connection.address import parse_address

    place = parse_address(address)
    folder = results.out or free_folder(f"{place.file_name}_track")
    names = needle_names(sending.names or [], points=sending.points)
    with ExitStack() as stack:
        status = stack.enter_context(console.status("waiting for the first volume"))
        live = stack.enter_context(live_source(place, reading, say))
        outlets = []
        for each in sending.serve or []:
            own = str(parse_address(each)) == str(place)
            outlets.append(live.link if own else stack.enter_context(opened(each, say)))
        pages = open_page(address)
        summary = track_live(
            live,
            **chosen,
            seed=tracker.seed,
            outlets=outlets,
            names=names,
            console=pages.console if pages else None,
            out=folder,
            limits=limits,
            correct_poses=tracker.correct_poses,
            after_volume=lambda k, found: status.update(f"volume {k + 1}  {found.mode}"),
            say=say,
        )
    console.print(live_table(summary))
    found = [f"{found_words(summary)}.", *pose_lines(summary)] if summary["volumes"] else []
    for line in filter(None, [*found, *reasons_lines(summary), brief_stream_finding(live)]):
        say(line)
    say(f"Results: {folder / 'estimates.csv'}")
    write_printed(results.json_path, summary)
    if pages:
        pages.end(console, mode_words(summary))
    _end_stream(summary)


def _track_file(
    path: Path,
    tracker: Tracker,
    chosen: dict[str, Any],
    reading: ReadingFrames,
    results: Results,
    open_page: "Callable[[str], Pages | None]",
    *,
    explain: bool,
    real_time: bool,
    log: Path | None,
) -> None:
    from sonoservo.diagrams.app.terminal import mode_table, mode_words, volume_progress
    from sonoservo.diagrams.app.viewed_run import ViewedRun
    from sonoservo.diagrams.app.volumes.opening import open_volumes
    from sonoservo.diagrams.app.volumes.track import track_recording
    from sonoservo.systems.evaluation.reports.verdict import reasons_lines

    recording = open_volumes(path, reading)
    _say_about(recording)
    name = path.name if path.is_dir() else path.stem.removesuffix(".seq").removesuffix(".nii")
    folder = results.out or free_folder(f"{name}_track")
    viewed = ViewedRun(log)
    pages = open_page(path.name)
    with volume_progress(console, "Tracking", path.name, len(recording)) as progress:

        def after_volume(number: int, estimate: "NeedleEstimate") -> None:
            progress.show(number + 1, estimate.mode)
            if log is not None:
                viewed.show(recording[number], estimate)

        result = track_recording(
            recording,
            **chosen,
            seed=tracker.seed,
            real_time=real_time,
            console=pages.console if pages else None,
            out=folder,
            explain=explain,
            correct_poses=tracker.correct_poses,
            command=shlex.join(["sonoservo", *sys.argv[1:]]),
            after_volume=after_volume,
        )
    viewed.end(result.log)
    console.print(mode_table(result.summary))
    for line in (result.found, *reasons_lines(result.summary)):
        say(line)
    say_report(folder)
    write_printed(results.json_path, result.summary)
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
    reading: ReadingFrames,
    limits: LiveLimits,
    results: Results,
    speed: Annotated[
        float, typer.Option(help="Playing speed; 0 for as fast as the slowest peer accepts.")
    ] = 1.0,
    wait_for: WaitOption = 1,
) -> None:
    """Record a live connection, or play a recording as a scanner would."""
    from sonoservo.diagrams.app.live.bridge import QUEUE, play_live, record_live
    from sonoservo.diagrams.app.live.serve import await_peers, opened
    from sonoservo.diagrams.app.volumes.check import brief_stream_finding
    from sonoservo.diagrams.app.volumes.opening import live_source, open_volumes
    from sonoservo.systems.live.connection.address import is_address, parse_address

    if is_address(source) == is_address(target):
        raise ConfigurationError(
            f"bridge: {source} and {target}: one must be an address (igtl://...), the other a file"
        )
    with refusing_values():
        if is_address(target):
            reading.refuse_for_files()
            refuse_for_files(limits)
            recording = open_volumes(Path(source), reading)
            _say_about(recording)
            with opened(target, say) as link:
                await_peers(link, wait_for)
                summary = play_live(recording, link, speed=speed)
            say(f"{counted(summary['volumes'], 'volume')} sent")
        else:
            reading.refuse_for_streams()
            with live_source(parse_address(source), reading, say, keep=QUEUE) as live:
                summary = record_live(live, Path(target), limits=limits, say=say)
                if line := brief_stream_finding(live):
                    say(line)
            reasons = summary["left_out_reasons"].items()
            left_out = "".join(f", {count} left out ({why})" for why, count in reasons)
            done = f"{counted(summary['volumes'], 'volume')} recorded, {summary['dropped']} dropped"
            say(f"{done}{left_out}" + (f": {target}" if summary["recording"] else ""))
    write_printed(results.json_path, summary)
    _end_stream(summary)


def _end_stream(summary: dict[str, Any]) -> None:
    """End with the exit status of a stream: interrupted, or without a single volume."""
    if summary["interrupted"]:
        raise typer.Exit(INTERRUPTED)
    if not summary["volumes"]:
        raise typer.Exit(1)


def locate_command(
    volume: Annotated[
        Path,
        typer.Argument(
            help="File with the volume: .nrrd, .nhdr, .mha, .mhd, .nii or .hdf5; or frames (also "
            ".dcm, .h5, a folder of PNG) with --reconstruct."
        ),
    ],
    curve: Curve,
    reading: ReadingFrames,
    printed: Printed,
    number: Annotated[
        int, typer.Option(help="Number of the volume, from 0, if the file has several.")
    ] = 0,
) -> None:
    """Find the needle in one volume; exit with 1 if there is none.

    Positions are in LPS, in mm, also of a file in RAS; of frames, in the frame of their poses.
    """
    import numpy as np

    from sonoservo.diagrams.app.volumes.locate import locate_in_recording
    from sonoservo.diagrams.app.volumes.opening import open_volumes
    from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters

    with refusing_values():
        parameters = NeedleLocalizerParameters().knowing(
            beam_width=curve.beam_width, echo_offset=curve.echo_offset
        )
    reading.refuse_for_files()
    if not reading.reconstruct:
        if reading.poses != "none":
            refuse_given(reading, "a volume has its own frame here", ("poses", "calibration"))
        reading.poses = "none"
    opened = open_volumes(volume, reading, timed=False)
    _say_about(opened)
    found = locate_in_recording(opened, number, order=curve.order, parameters=parameters)
    for name, value in found.items():
        shown = np.round(value, 3).tolist() if isinstance(value, list | float) else value
        say(f"{name}: {shown}")
    write_printed(printed.json_path, found)
    if not found["found"]:
        if len(opened) > 1:
            say_notes(
                f"the file has {len(opened)} volumes; --number 0 to {len(opened) - 1} chooses one"
            )
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
    reading: Reading,
    results: Results,
    listening: Listening,
) -> None:
    """Say what is in a file or a stream, and what is wrong with it; exit with 1 if something is.

    A picture marks where the probe is taken to be, and which way is up.
    """
    from sonoservo.diagrams.app.terminal import findings_table
    from sonoservo.diagrams.app.volumes.check import check_file, check_stream
    from sonoservo.systems.evaluation.reports.plots import png
    from sonoservo.systems.files.writing import write_atomically
    from sonoservo.systems.live.connection.address import is_address, parse_address

    if is_address(source):
        reading.refuse_for_streams()
        address = parse_address(source)
        name = address.file_name
        checked = check_stream(address, reading, **vars(listening), say=say)
    else:
        reading.refuse_for_files()
        refuse_for_files(listening)
        name = Path(source).name
        with console.status("looking at the volumes"):
            checked = check_file(Path(source), reading)
    console.print(findings_table(checked.findings))
    if checked.picture is not None:
        path = (results.out or Path("out") / f"{name}_check") / "orientation.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, png(checked.picture))
        say(f"Picture: {path}")
    write_printed(results.json_path, checked.figures())
    if checked.gravest is not None:
        raise typer.Exit(1)


def calibrate_command(
    recording: Annotated[Path, typer.Argument(help="Recorded volumes with poses, as for track.")],
    reading: Reading,
    results: Results,
) -> None:
    """Report delay and calibration error of a recording's poses; exit with 1 if they are unknown.

    The tissue must stand still while the probe moves.
    """
    from sonoservo.diagrams.app.terminal import pose_error_table, volume_progress
    from sonoservo.diagrams.app.volumes.calibrate import calibrate_recording, pose_error_figures
    from sonoservo.diagrams.app.volumes.opening import open_volumes

    reading.refuse_for_files()
    opened = open_volumes(recording, reading)
    say_notes(*opened.notes)
    with volume_progress(console, "Calibrating", recording.name, len(opened)) as progress:
        figures = pose_error_figures(
            calibrate_recording(opened, after_volume=lambda number: progress.show(number + 1))
        )
    console.print(pose_error_table(figures) if figures["found"] else figures["reason"])
    write_printed(results.json_path, figures)
    if not figures["found"]:
        raise typer.Exit(1)


def _say_about(opened: "Opened") -> None:
    """Print how a file was read, and the gravest thing that its header tells."""
    from sonoservo.diagrams.app.volumes.check import brief_finding

    say_notes(*opened.notes)
    if line := brief_finding(opened):
        console.print(line, style="yellow", soft_wrap=True)
