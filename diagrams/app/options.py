"""Options of the commands of ``sonoservo``, a dataclass for each concern, and their console.

A dataclass is both what the parser offers, as a panel of the help, and what the functions take.
"""

import inspect
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, fields, is_dataclass
from functools import partial, wraps
from itertools import chain, count
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import typer
from rich.console import Console

from sonoservo.diagrams.studies.cluster.opening import CASE_LIMIT_S
from sonoservo.systems.files.memory import DEFAULT_MEMORY_GB, set_memory_budget
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import to_json, write_json
from sonoservo.systems.signals.requirements import Bounded, Positive, above

console = Console(markup=False, emoji=False)
"""Console of all commands. It takes no markup, because paths may contain square brackets."""


@contextmanager
def waiting(words: str) -> Iterator[None]:
    """Say what takes a while: a moving line in a terminal, and a plain one elsewhere."""
    if not console.is_terminal:
        console.print(words)
    with console.status(words):
        yield


_STANDARD_OUTPUT = Path("-")
_FOR_STREAMS = "it is for connections, and the source is a file"


def refuse_given(options: Any, why: str, names: Collection[str] = ()) -> None:
    """Refuse options of a concern, or those of some names, that are not the default."""
    hints = get_type_hints(type(options), include_extras=True)
    for each in fields(options):
        if (not names or each.name in names) and getattr(options, each.name) != each.default:
            named = str(hints[each.name].__metadata__[-1].default)  # typer takes it for the default
            usual = f"--{each.name.replace('_', '-')}"
            raise ConfigurationError(f"{named if named[:2] == '--' else usual}: {why}")


def refuse_for_files(*options: Any) -> None:
    """Refuse options of concerns that only connections have."""
    for each in options:
        refuse_given(each, _FOR_STREAMS)


ScenarioArgument = Annotated[
    str, typer.Argument(help="Name from `sonoservo list`, or path of a YAML file.")
]
ChangesOption = Annotated[
    list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value; repeatable.")
]
SeedOption = Annotated[int | None, typer.Option(min=0, help="Random seed of the run.")]
WaitOption = Annotated[int, typer.Option(min=0, help="Live: number of peers to wait for.")]
LogOption = Annotated[
    Path | None,
    typer.Option("--log", help="Log for a viewer: NAME.rrd (Rerun), NAME.mcap (Foxglove)."),
]
ExplainOption = Annotated[
    bool,
    typer.Option(
        "--explain", help="Keep what the tracker saw around a loss; see `sonoservo explain`."
    ),
]
DebugOption = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of an error.", show_default=False)
]
MemoryOption = Annotated[
    float | None,
    typer.Option(
        help=f"Memory in GB that one file or setting may need; {DEFAULT_MEMORY_GB:g} by default."
    ),
]


def _metres(given: Any) -> float:
    """Return a length in m of a text in mm; a default is in m already."""
    if not isinstance(given, str):
        return given
    length = float(given)
    if not length >= 0:
        raise typer.BadParameter(f"{given} is not allowed; expected a length in mm")
    return 1e-3 * length


def millimetres(name: str, help: str) -> Any:
    """Return an option for a length that a person gives in mm; its value is in m."""
    return typer.Option(name, parser=_metres, metavar="MM", help=help, show_default=False)


@dataclass(kw_only=True)
class Volumes:
    """Volumes."""

    depth: Annotated[
        str, typer.Option(help="Direction of the sound in the file's space: L, R, P, A, S or I.")
    ] = "P"
    volume_rate: Annotated[
        float | None, typer.Option(help="Volumes per second, for a file without times.")
    ] = None


@dataclass(kw_only=True)
class Poses:
    """Poses."""

    poses: Annotated[
        str | None,
        typer.Option(
            help="Transforms that lead from the image or probe to a fixed frame, with commas "
            "between them, or the ends of such a chain (ImageToReference), or none; by default, "
            "it is found."
        ),
    ] = None
    plus_config: Annotated[
        Path | None,
        typer.Option(
            help="Configuration of PLUS (.xml) with the transforms and the images' orientation."
        ),
    ] = None
    calibration: Annotated[
        str | None,
        typer.Option(
            help="ImageToProbe in mm: 16 numbers, row by row, or a file with them; "
            "NAME=... for another transform."
        ),
    ] = None
    clock_offset: Annotated[
        float | None,
        typer.Option(
            help="Live: time stamps of the poses minus those of images taken at the same time, in "
            "s; by default 0, or what the times of arrival tell."
        ),
    ] = None


@dataclass(kw_only=True)
class GreyLevels:
    """Grey levels."""

    window: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Numbers shown as black and white, such as --window 0 200; by default, from the "
            "first volumes."
        ),
    ] = None
    dynamic_range_db: Annotated[
        float | None, typer.Option(help="dB from black to white; by default, from the file or 60.")
    ] = None
    void: Annotated[
        float | None,
        typer.Option(help="Number that stands for what was not seen, such as 0, -32768 or nan."),
    ] = None
    luminance: Annotated[
        bool, typer.Option("--luminance", help="Take the luminance of colours as grey levels.")
    ] = False


@dataclass(kw_only=True)
class Reading(GreyLevels, Poses, Volumes):
    """Reading of volumes from a file or a connection."""

    def refuse_for_streams(self) -> None:
        """Refuse what only files have."""
        names = ("plus_config", "calibration", "void", "luminance", "volume_rate")
        refuse_given(self, "it is for files, and the source is a connection", names)

    def refuse_for_files(self) -> None:
        """Refuse what only connections have."""
        refuse_given(self, _FOR_STREAMS, ("clock_offset", "motor"))


@dataclass(kw_only=True)
class Frames:
    """Volumes of 2D frames."""

    reconstruct: Annotated[
        bool,
        typer.Option(
            "--reconstruct", help="Reconstruct volumes from tracked 2D frames, as of PLUS."
        ),
    ] = False
    motor: Annotated[
        Path | None,
        typer.Option(help="Live 2D frames of a motorised probe: YAML file of its sweep."),
    ] = None
    frames: Annotated[
        int | None,
        typer.Option(help="Frames per volume; by default, one sweep in either direction."),
    ] = None
    spacing: Annotated[
        float, millimetres("--spacing", "Size of reconstructed voxels in mm; 0.7 by default.")
    ] = 7e-4


@dataclass(kw_only=True)
class ReadingFrames(Frames, Reading):
    """Reading of volumes, or of 2D frames that volumes are made of."""

    def refuse_for_files(self) -> None:
        """Refuse what only connections have, and what reconstruction alone needs."""
        super().refuse_for_files()
        self._refuse_for_volumes()

    def refuse_for_streams(self) -> None:
        """Refuse what only files have, and what reconstruction alone needs."""
        super().refuse_for_streams()
        self._refuse_for_volumes()

    def _refuse_for_volumes(self) -> None:
        if not self.reconstruct:
            refuse_given(self, "it is for frames, with --reconstruct", ("frames", "spacing"))


@dataclass(kw_only=True)
class Curve:
    """Needle."""

    order: Annotated[
        int, typer.Option(min=2, max=3, help="Order of the curve: 2 straight, 3 bent.")
    ] = 2
    beam_width: Annotated[
        float | None,
        millimetres(
            "--beam-width",
            "Width of the beam along the needle in mm, for volumes that do not carry it; by "
            "default, it is measured from the speckle.",
        ),
    ] = None
    echo_offset: Annotated[
        float | None,
        millimetres(
            "--echo-offset",
            "Distance in mm by which the needle's axis lies deeper than the centre of its echo, "
            "about two thirds of its radius; 0.4 by default, 0 for the echo itself.",
        ),
    ] = None


@dataclass(kw_only=True)
class Tracker(Curve):
    """Tracker."""

    tracker: Annotated[
        str,
        typer.Option(
            help="Name of a tracker, such as chatelain2013 or zhao2012, or module:factory of your "
            "own."
        ),
    ] = "chatelain2013"
    start: Annotated[
        str, typer.Option(help="search: wait for an insertion; anywhere: look in whole volumes.")
    ] = "search"
    seed: Annotated[
        int | None, typer.Option(min=0, help="Random seed; by default, the recorder's.")
    ] = None
    correct_poses: Annotated[
        bool,
        typer.Option(
            "--correct-poses",
            help="Correct the delay and the calibration of the poses; see calibrate.",
        ),
    ] = False


@dataclass(kw_only=True)
class LiveLimits(Bounded):
    """Limits of a live connection."""

    volumes: Annotated[
        Annotated[int, above(0)] | None, typer.Option(help="Live: end after this many volumes.")
    ] = None
    patience: Annotated[
        Positive | None,
        typer.Option(help="Live: end if no volume arrives for this long, in s."),
    ] = None


@dataclass(kw_only=True)
class Listening:
    """Listening to a connection."""

    seconds: Annotated[
        float,
        typer.Option(min=0.5, help="Live: time to listen after the first message, in s."),
    ] = 5.0
    patience: Annotated[
        float, typer.Option(help="Live: time to wait for the first message, in s.")
    ] = 30.0


@dataclass(kw_only=True)
class Sending:
    """Sending live."""

    serve: Annotated[
        list[str] | None,
        typer.Option(help="Live: address to send estimates to; the source's own is allowed."),
    ] = None
    names: Annotated[
        list[str] | None,
        typer.Option("--name", help="Live: device names: tip=, curve=, status=, covariance=."),
    ] = None
    points: Annotated[
        bool, typer.Option("--points", help="Live: send control points (POINT) in place of a line.")
    ] = False


@dataclass(kw_only=True)
class Serving:
    """Sending live."""

    serve: Annotated[
        str | None,
        typer.Option(
            help="Send all data live; igtl://:18944 lets programs on this machine connect."
        ),
    ] = None
    wait_for: WaitOption = 0


@dataclass(kw_only=True)
class Page:
    """Page in the browser."""

    host: Annotated[
        str, typer.Option(help="Address to serve the page on; * for all addresses of this machine.")
    ] = "localhost"
    open_page: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in the browser of this desktop.")
    ] = True


@dataclass(kw_only=True)
class Workers:
    """Processes and cluster."""

    jobs: Annotated[int, typer.Option(help="Number of processes; -1 for one per core.")] = -1
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Run on a cluster of Dask: tcp://HOST:PORT, local:N, or a FILE.yaml for a job "
            "queue."
        ),
    ] = None
    case_limit: Annotated[float, typer.Option(help="Longest time in s of a run on a cluster.")] = (
        CASE_LIMIT_S
    )


@dataclass(kw_only=True)
class Printed:
    """Results."""

    json_path: Annotated[
        Path | None,
        typer.Option(
            "--json", help="Also write the printed figures to this file; - prints only them."
        ),
    ] = None


@dataclass(kw_only=True)
class Results(Printed):
    """Results."""

    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None


def with_common_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options that all have, and its dataclasses' fields as options.

    A parameter of a dataclass's type gives way to its fields, in a panel of the help named after
    the class that defines them. An error carries the choice of ``--debug`` and the command's name.
    """
    hints = get_type_hints(command, include_extras=True)
    parameters: dict[str, tuple[Any, Any]] = {}
    concerns: dict[str, Any] = {}
    for name, each in inspect.signature(command).parameters.items():
        if is_dataclass(hints[name]):
            concerns[name] = hints[name]
            parameters |= _options_of(hints[name])
        else:
            parameters[name] = hints[name], each.default
    parameters |= {"debug": (DebugOption, False), "max_memory": (MemoryOption, None)}

    @wraps(command)
    def run(*, debug: bool, max_memory: float | None, **options: Any) -> None:
        try:
            for name, value in options.items():
                _require_text(name, value)
            _require_file_of_its_own(options.get("json_path"), options)
            with set_memory_budget(max_memory, "--max-memory"):
                console.stderr = options.get("json_path") == _STANDARD_OUTPUT
                made = {name: _made(schema, options) for name, schema in concerns.items()}
                command(**options, **made)
        except BaseException as error:
            error.debug = debug  # type: ignore[attr-defined]
            error.command = command.__name__  # type: ignore[attr-defined]
            raise

    keyword = partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            keyword(name, default=default, annotation=hint)
            for name, (hint, default) in parameters.items()
        ]
    )
    run.__annotations__ = {name: hint for name, (hint, _) in parameters.items()}
    return run


def _options_of(schema: Any) -> dict[str, tuple[Any, Any]]:
    """Return annotation and default of the option that each field of a dataclass stands for."""
    options = {}
    hints = get_type_hints(schema, include_extras=True)
    for each in fields(schema):
        owner = next(c for c in schema.__mro__ if each.name in vars(c).get("__annotations__", {}))
        option = copy(hints[each.name].__metadata__[-1])
        option.rich_help_panel = owner.__doc__.rstrip(".")
        options[each.name] = Annotated[_plain(hints[each.name].__origin__), option], each.default
    return options


def _plain(hint: Any) -> Any:
    """Return a type without its bounds, which the dataclass checks."""
    if get_origin(hint) is Annotated:
        return hint.__origin__
    inner = tuple(map(_plain, get_args(hint)))
    return inner[0] | inner[1] if get_origin(hint) in (Union, UnionType) else hint


def _made(schema: Any, options: dict[str, Any]) -> Any:
    """Return a dataclass of the options that are its fields, which are taken out."""
    with refusing_values():
        return schema(**{each.name: options.pop(each.name) for each in fields(schema)})


@contextmanager
def refusing_values(source: object = "") -> Iterator[None]:
    """Turn a ValueError, which names what is not allowed, into a ConfigurationError."""
    try:
        yield
    except ValueError as error:
        raise ConfigurationError(f"{source}: {error}" if source else str(error)) from error


def _require_text(name: str, value: object) -> None:
    """Raise ConfigurationError for text that no file of results could hold."""
    for each in value if isinstance(value, list | tuple) else [value]:
        if isinstance(each, str | Path):
            try:
                str(each).encode()
            except UnicodeEncodeError as error:
                raise ConfigurationError(
                    f"{name}: {str(each)!a} is not UTF-8; rename the file or folder"
                ) from error


def _require_file_of_its_own(path: Path | None, options: Mapping[str, Any]) -> None:
    """Raise ConfigurationError if ``--json`` names a folder, or a file that is read."""
    if path is None or not path.exists():
        return
    if path.is_dir():
        raise ConfigurationError(f"--json: {path} is a folder; it must be a file, or -")
    for name, value in options.items():
        read = name != "json_path" and isinstance(value, str | Path) and os.path.exists(value)
        if read and os.path.samefile(value, path):
            raise ConfigurationError(
                f"--json: {path} is the {name} itself; it must be another file, or -"
            )


def say(line: str) -> None:
    """Print a line as it is: without markup, colours or folding."""
    console.print(line, soft_wrap=True, highlight=False)


def say_notes(*notes: str) -> None:
    """Print what a person should know about how a file was read."""
    for note in notes:
        say(f"{note[:1].upper()}{note[1:]}.")


def say_probe(name: str) -> None:
    """Print which fields of the transducer a probe's file leaves out, if it does."""
    from sonoservo.systems.ultrasound.transducer import assumed_fields

    if assumed := assumed_fields(name):
        say(f"{name} leaves out what is taken from the 4DC7-3/40: {', '.join(assumed)}.")


def say_report(folder: Path) -> None:
    """Print where the report is, if it could be written."""
    if (folder / "report.html").is_file():
        console.print(f"Report: {folder / 'report.html'}", soft_wrap=True)


def free_folder(name: str) -> Path:
    """Return the folder for results that nobody named, numbered if there is one of that name."""
    first = Path("out") / name
    numbered = (first.with_name(f"{name}_{number}") for number in count(2))
    return next(path for path in chain([first], numbered) if not path.exists())


def write_printed(path: Path | None, data: Any) -> None:
    """Write the figures that a command printed, if ``--json`` names a file or is ``-``."""
    if path == _STANDARD_OUTPUT:
        print(to_json(data))
    elif path is not None:
        write_json(path, data)
