"""Options that several commands of ``sonoservo`` take, and where they print."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from sonoservo.systems.files.writing import write_json

console = Console()

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


def write_printed(path: Path | None, data: Any) -> None:
    """Write what a command printed, if ``--json`` names a file."""
    if path is not None:
        write_json(path, data)
