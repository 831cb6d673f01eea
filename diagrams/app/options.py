"""Options that several commands of ``sonoservo`` take, and where they print."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from sonoservo.systems.files.writing import write_json

console = Console()

ScenarioArgument = Annotated[
    str, typer.Argument(help="A name from `sonoservo list`, or a YAML file.")
]
ChangesOption = Annotated[
    list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value.")
]
SeedOption = Annotated[int | None, typer.Option(help="Seed of everything random.")]
OutOption = Annotated[Path | None, typer.Option(help="Folder for the results.")]
JobsOption = Annotated[int, typer.Option(help="Processes; -1 means one for each core.")]
JsonOption = Annotated[
    Path | None, typer.Option("--json", help="Also write what is printed to this file.")
]
HostOption = Annotated[
    str, typer.Option(help="Address that the page is served on; * for all of this machine's.")
]
DepthOption = Annotated[
    str,
    typer.Option(help="Where the sound goes in the file's space: L, R, P, A, S or I (the feet)."),
]
WindowOption = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Numbers that become black and white; by default from the first volume."),
]
OrderOption = Annotated[int, typer.Option(help="2 for a straight needle, 3 for a bent one.")]
DynamicRangeOption = Annotated[
    float | None, typer.Option(help="dB from black to white; 60 unless the file tells it.")
]
RateOption = Annotated[
    float | None, typer.Option(help="Volumes per second, for a file that tells no times.")
]
PosesOption = Annotated[
    str | None,
    typer.Option(help="Transform that is the probe's pose (ProbeToTracker), or none."),
]
ServeOption = Annotated[
    str | None,
    typer.Option(help="Send all of it live: igtl://:18944 lets programs on this machine connect."),
]
WaitOption = Annotated[int, typer.Option(help="Live: begin when so many peers are connected.")]
ReconstructOption = Annotated[
    bool, typer.Option("--reconstruct", help="Make volumes of tracked 2D frames (PLUS: .igs.mha).")
]
MotorOption = Annotated[
    Path | None, typer.Option(help="Live 2D frames of a motorised probe: a YAML of its sweep.")
]
FramesOption = Annotated[
    int | None, typer.Option(help="Frames of each volume; by default one sweep to or fro.")
]
SpacingOption = Annotated[float, typer.Option(help="Of reconstructed voxels, in mm.")]
VolumesOption = Annotated[int | None, typer.Option(help="Live: end after so many volumes.")]
PatienceOption = Annotated[
    float | None, typer.Option(help="Live: end when none has come for so long, in s.")
]


def write_printed(path: Path | None, data: Any) -> None:
    """Write what a command printed, if ``--json`` names a file."""
    if path is not None:
        write_json(path, data)
