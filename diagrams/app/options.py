"""Options shared by several commands of ``sonoservo``, and their console."""

import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import wraps
from itertools import chain, count
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from sonoservo.systems.files.memory import DEFAULT_MEMORY_GB, set_memory_budget
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import to_json, write_json

console = Console(markup=False, emoji=False)
"""Console of all commands. It takes no markup, because paths may contain square brackets."""


@contextmanager
def waiting(words: str, shown: bool = True) -> Iterator[None]:
    """Say what takes a while: a moving line in a terminal if `shown`, and a plain one elsewhere."""
    if not console.is_terminal:
        console.print(words)
    with console.status(words) if shown else nullcontext():
        yield


_STANDARD_OUTPUT = Path("-")

ScenarioArgument = Annotated[
    str, typer.Argument(help="Name from `sonoservo list`, or path of a YAML file.")
]
ChangesOption = Annotated[
    list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value; repeatable.")
]
SeedOption = Annotated[int | None, typer.Option(min=0, help="Random seed of the run.")]
OutOption = Annotated[Path | None, typer.Option(help="Folder for the results.")]
JobsOption = Annotated[int, typer.Option(help="Number of processes; -1 for one per core.")]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        help="Run on a cluster of Dask: tcp://HOST:PORT, local:N, or a FILE.yaml for a job queue."
    ),
]
CaseLimitOption = Annotated[
    float, typer.Option("--case-limit", help="Longest time in s of a run on a cluster.")
]
JsonOption = Annotated[
    Path | None,
    typer.Option("--json", help="Also write the printed figures to this file; - prints only them."),
]
HostOption = Annotated[
    str, typer.Option(help="Address to serve the page on; * for all addresses of this machine.")
]
OpenOption = Annotated[
    bool, typer.Option("--open/--no-open", help="Open the page in the browser of this desktop.")
]
DepthOption = Annotated[
    str,
    typer.Option(help="Direction of the sound in the file's space: L, R, P, A, S or I."),
]
WindowOption = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Numbers shown as black and white; by default, from the first volumes."),
]
OrderOption = Annotated[
    int, typer.Option(min=2, max=3, help="Order of the curve: 2 straight, 3 bent.")
]
DynamicRangeOption = Annotated[
    float | None, typer.Option(help="dB from black to white; by default, from the file or 60.")
]
RateOption = Annotated[
    float | None, typer.Option(help="Volumes per second, for a file without times.")
]
ExplainOption = Annotated[
    bool,
    typer.Option(
        "--explain", help="Keep what the tracker saw around a loss; see `sonoservo explain`."
    ),
]
PosesOption = Annotated[
    str | None,
    typer.Option(
        help="Transforms that lead from the image or probe to a fixed frame, with commas between "
        "them, or the ends of such a chain (ImageToReference), or none; by default, it is found."
    ),
]
PlusConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--plus-config",
        help="Configuration of PLUS (.xml) with the transforms and the images' orientation.",
    ),
]
CalibrationOption = Annotated[
    str | None,
    typer.Option(
        help="ImageToProbe in mm: 16 numbers, row by row, or a file with them; "
        "NAME=... for another transform."
    ),
]
VoidOption = Annotated[
    float | None,
    typer.Option(help="Number that stands for what was not seen, such as 0, -32768 or nan."),
]
LuminanceOption = Annotated[
    bool,
    typer.Option("--luminance", help="Take the luminance of colours as grey levels."),
]
ClockOffsetOption = Annotated[
    float | None,
    typer.Option(
        "--clock-offset",
        help="Live: time stamps of the poses minus those of images taken at the same time, in s; "
        "by default 0, or what the times of arrival tell.",
    ),
]
ServeOption = Annotated[
    str | None,
    typer.Option(help="Send all data live; igtl://:18944 lets programs on this machine connect."),
]
WaitOption = Annotated[int, typer.Option(min=0, help="Live: number of peers to wait for.")]
ReconstructOption = Annotated[
    bool,
    typer.Option("--reconstruct", help="Reconstruct volumes from tracked 2D frames, as of PLUS."),
]
MotorOption = Annotated[
    Path | None, typer.Option(help="Live 2D frames of a motorised probe: YAML file of its sweep.")
]
FramesOption = Annotated[
    int | None, typer.Option(help="Frames per volume; by default, one sweep in either direction.")
]
SpacingOption = Annotated[float, typer.Option(help="Size of reconstructed voxels, in mm.")]
VolumesOption = Annotated[int | None, typer.Option(help="Live: end after this many volumes.")]
PatienceOption = Annotated[
    float | None, typer.Option(help="Live: end if no volume arrives for this long, in s.")
]

DebugOption = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of an error.", show_default=False)
]
BeamWidthOption = Annotated[
    float | None,
    typer.Option(
        "--beam-width",
        help="Width of the beam along the needle in mm, for volumes that do not carry it; by "
        "default, it is measured from the speckle.",
    ),
]
EchoOffsetOption = Annotated[
    float | None,
    typer.Option(
        "--echo-offset",
        help="Distance in mm from the centre of the needle's echo to its axis, if known; "
        "about two thirds of its radius.",
    ),
]
MemoryOption = Annotated[
    float | None,
    typer.Option(
        help=f"Memory in GB that one file or setting may need; {DEFAULT_MEMORY_GB:g} by default."
    ),
]


def with_common_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options that all have: ``--debug`` and ``--max-memory``.

    An error carries the choice of ``--debug`` and the command's name to
    `sonoservo.diagrams.app.cli.run_arguments` as its attributes ``debug`` and ``command``.
    """

    @wraps(command)
    def run(*args: Any, debug: bool, max_memory: float | None, **options: Any) -> None:
        try:
            for name, value in options.items():
                _require_text(name, value)
            with set_memory_budget(max_memory, "--max-memory"):
                console.stderr = options.get("json_path") == _STANDARD_OUTPUT
                command(*args, **options)
        except BaseException as error:
            error.debug = debug  # type: ignore[attr-defined]
            error.command = command.__name__  # type: ignore[attr-defined]
            raise

    common = {"debug": (DebugOption, False), "max_memory": (MemoryOption, None)}
    signature = inspect.signature(command)
    parameters = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=each)
        for name, (each, default) in common.items()
    ]
    parameters = [*signature.parameters.values(), *parameters]
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    hints = {name: each for name, (each, _) in common.items()}
    run.__annotations__ = {**command.__annotations__, **hints}
    return run


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


def say_notes(*notes: str) -> None:
    """Print what a person should know about how a file was read."""
    for note in notes:
        console.print(f"{note[:1].upper()}{note[1:]}.", soft_wrap=True, highlight=False)


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
