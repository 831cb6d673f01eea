"""Options shared by several commands of ``sonoservo``, and their console."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from sonoservo.systems.files.writing import write_json

console = Console()

ScenarioArgument = Annotated[
    str, typer.Argument(help="Name from `sonoservo list`, or path of a YAML file.")
]
ChangesOption = Annotated[
    list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value; repeatable.")
]
SeedOption = Annotated[int | None, typer.Option(help="Random seed of the run.")]
OutOption = Annotated[Path | None, typer.Option(help="Folder for the results.")]
JobsOption = Annotated[int, typer.Option(help="Number of processes; -1 for one per core.")]
JsonOption = Annotated[
    Path | None, typer.Option("--json", help="Also write the printed figures to this file.")
]
HostOption = Annotated[
    str, typer.Option(help="Address to serve the page on; * for all addresses of this machine.")
]
DepthOption = Annotated[
    str,
    typer.Option(help="Direction of the sound in the file's space: L, R, P, A, S or I."),
]
WindowOption = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Numbers shown as black and white; by default, from the first volume."),
]
OrderOption = Annotated[int, typer.Option(help="Order of the curve: 2 straight, 3 bent.")]
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
    typer.Option(help="Transform to use as the probe's pose (ProbeToTracker), or none."),
]
ServeOption = Annotated[
    str | None,
    typer.Option(help="Send all data live; igtl://:18944 lets programs on this machine connect."),
]
WaitOption = Annotated[int, typer.Option(help="Live: number of peers to wait for.")]
ReconstructOption = Annotated[
    bool,
    typer.Option(
        "--reconstruct", help="Reconstruct volumes from tracked 2D frames (PLUS .igs.mha)."
    ),
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


def write_printed(path: Path | None, data: Any) -> None:
    """Write the figures that a command printed, if ``--json`` names a file."""
    if path is not None:
        write_json(path, data)
