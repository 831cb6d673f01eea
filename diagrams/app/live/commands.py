"""Terminal output and argument checks of the commands that exchange data with other programs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydrake.systems.framework import System
from rich.console import Console

from sonoservo.diagrams.app.live.bridge import QUEUE, play_live, record_live
from sonoservo.diagrams.app.live.serve import live_senders, opened
from sonoservo.diagrams.app.live.track_live import LiveLimits, track_live
from sonoservo.diagrams.app.terminal import live_table, reasons_lines
from sonoservo.diagrams.app.volumes.check import brief_finding, brief_stream_finding
from sonoservo.diagrams.app.volumes.opening import open_volumes
from sonoservo.diagrams.scenario import Scenario
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.live.connection.protocols import Address, is_address, parse_address
from sonoservo.systems.live.frames_to_volumes import FramesToVolumes
from sonoservo.systems.live.live_source import ImagesToVolumes, LiveSource
from sonoservo.systems.live.motor_sweep import MotorSweepVolumes, load_motor_sweep
from sonoservo.systems.live.needle_sender import NeedleNames
from sonoservo.systems.live.volume_maker import VolumeMaker

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console as Page

_NAMED = ("tip", "curve", "status", "covariance")


def saying(console: Console) -> Callable[[str], None]:
    """Return a function that prints a line without markup."""
    return lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True)


@contextmanager
def serving(
    console: Console, address: str | None, scenario: Scenario, wait_for: int = 0
) -> Iterator[Mapping[str, System] | None]:
    """Yield the systems that send a scenario live while it runs; None without an address.

    Parameters
    ----------
    console
        Console for messages about the connection.
    address
        Address to send to.
    scenario
        Scenario of the run.
    wait_for
        Number of peers that must be connected first.
    """
    if address is None:
        yield None
        return
    with opened(address, saying(console), wait_for=wait_for) as link:
        yield live_senders(link, scenario)


def needle_names(changes: Sequence[str], *, points: bool = False) -> NeedleNames:
    """Return the device names of estimates, changed by texts such as ``tip=MyNeedle``.

    Raises
    ------
    ConfigurationError
        If a change is not allowed; the message names it.
    """
    names = NeedleNames(points=points)
    for change in changes:
        field, equals, name = change.partition("=")
        if field not in _NAMED or not equals:
            raise ConfigurationError(f"name: {change!r}; {suggest(field, _NAMED)}")
        try:
            changed: dict[str, Any] = {field: name}
            names = replace(names, **changed)
        except ValueError as error:
            raise ConfigurationError(str(error)) from error
    return names


def make_maker(
    *,
    depth: str = "P",
    window: tuple[float, float] | None = None,
    dynamic_range_db: float | None = None,
    reconstruct: bool = False,
    motor: Path | None = None,
    frames: int | None = None,
    spacing: float = 7e-4,
) -> ImagesToVolumes:
    """Return the converter of received images to volumes.

    Parameters
    ----------
    depth, window, dynamic_range_db
        See `VolumeMaker`; a motor's file contains its own dynamic range.
    reconstruct
        Whether the images are 2D frames with poses.
    motor
        File that describes the sweep of a motorised probe, whose images are 2D frames without
        poses.
    frames, spacing
        See `FramesToVolumes`.

    Raises
    ------
    ConfigurationError
        If a value is not allowed; the message names it.
    """
    try:
        if motor is not None:
            return MotorSweepVolumes(load_motor_sweep(motor), window=window)
        if reconstruct:
            return FramesToVolumes(
                window=window, dynamic_range_db=dynamic_range_db, frames=frames, spacing=spacing
            )
        return VolumeMaker(depth=depth, window=window, dynamic_range_db=dynamic_range_db)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error


def track_address(
    console: Console,
    address: str,
    *,
    parameters: TrackerParameters,
    maker: ImagesToVolumes,
    poses: str | None,
    clock_offset: float | None,
    seed: int | None,
    page: "Page | None",
    serve: Sequence[str],
    names: NeedleNames,
    limits: LiveLimits,
    correct_poses: bool,
    out: Path | None,
) -> dict[str, Any]:
    """Track live volumes until Ctrl-C or a limit, and print the figures; see `track_live`."""
    say = saying(console)
    place = parse_address(address)
    folder = out or Path("out") / f"{_file_name(place)}_track"
    source = LiveSource(place, maker=maker, poses=poses, clock_offset=clock_offset, report=say)
    with ExitStack() as stack:
        outlets = []
        for each in serve:
            own = str(parse_address(each)) == str(place)
            outlets.append(source.link if own else stack.enter_context(opened(each, say)))
        stack.enter_context(source)
        if place.listens:
            say(f"Waiting for a scanner on port {source.link.port}; Ctrl-C ends")
        with console.status("waiting for the first volume") as status:
            summary = track_live(
                source,
                parameters=parameters,
                seed=seed,
                outlets=outlets,
                names=names,
                console=page,
                out=folder,
                limits=limits,
                correct_poses=correct_poses,
                after_volume=lambda number, estimate: status.update(
                    f"volume {number + 1}  {estimate.mode}"
                ),
                say=say,
            )
    console.print(live_table(summary))
    for line in filter(None, [*reasons_lines(summary), brief_stream_finding(source)]):
        say(line)
    console.print(f"Results: {folder / 'estimates.csv'}", soft_wrap=True)
    return summary


def bridge_files(
    console: Console,
    source: str,
    target: str,
    *,
    depth: str,
    window: tuple[float, float] | None,
    dynamic_range_db: float | None,
    reconstruct: bool,
    motor: Path | None,
    frames: int | None,
    spacing: float,
    poses: str | None,
    clock_offset: float | None,
    speed: float,
    wait_for: int,
    limits: LiveLimits,
    **reading: Any,
) -> dict[str, Any]:
    """Record a live connection to a file, or play a file to one.

    ``reading`` holds the arguments of `open_volumes` that only files have.

    Raises
    ------
    ConfigurationError
        Unless exactly one of ``source`` and ``target`` is an address.
    """
    if is_address(source) == is_address(target):
        raise ConfigurationError(
            f"bridge: {source} and {target}: one must be an address (igtl://...), the other a file"
        )
    say = saying(console)
    try:
        if is_address(target):
            recording = open_volumes(
                Path(source),
                reconstruct=reconstruct,
                depth=depth,
                window=window,
                dynamic_range_db=dynamic_range_db,
                poses=poses,
                frames=frames,
                spacing=spacing,
                **reading,
            )
            for note in recording.notes:
                say(note)
            if line := brief_finding(recording):
                say(line)
            with opened(target, say, wait_for=wait_for) as link:
                summary = play_live(recording, link, speed=speed)
            say(f"{summary['volumes']} volumes sent")
            return summary
        only_for_files(**reading)
        place = parse_address(source)
        maker = make_maker(
            depth=depth,
            window=window,
            dynamic_range_db=dynamic_range_db,
            reconstruct=reconstruct,
            motor=motor,
            frames=frames,
            spacing=spacing,
        )
        with LiveSource(
            place, maker=maker, poses=poses, keep=QUEUE, clock_offset=clock_offset, report=say
        ) as live:
            if place.listens:
                say(f"Waiting for a scanner on port {live.link.port}; Ctrl-C ends")
            summary = record_live(live, Path(target), limits=limits, say=say)
            if line := brief_stream_finding(live):
                say(line)
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    reasons = summary["left_out_reasons"].items()
    left_out = "".join(f", {count} left out ({why})" for why, count in reasons)
    say(f"{summary['volumes']} volumes recorded, {summary['dropped']} dropped{left_out}: {target}")
    return summary


def _file_name(address: Address) -> str:
    host = address.host.replace(":", "_") or "localhost"
    return f"{host}_{address.port}"


def only_for_files(**reading: Any) -> None:
    """Refuse arguments of `open_volumes` that a live connection does not use.

    Raises
    ------
    ConfigurationError
        If one of them is given.
    """
    for name, value in reading.items():
        if value is not None and value is not False:
            option = name.replace("_", "-")
            raise ConfigurationError(f"--{option}: it is for files, and the source is a connection")
