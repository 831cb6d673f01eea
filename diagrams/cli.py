"""The command line: ``sonoservo list``, ``run`` and ``scan``."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from sonoservo.diagrams.scan import caption, scan, summarize_scan, write_scan
from sonoservo.diagrams.scenario import list_scenarios, load_scenario
from sonoservo.diagrams.simulation import run
from sonoservo.diagrams.terminal import Progress, start_display, summary_table
from sonoservo.systems.recording.files import write_atomically
from sonoservo.systems.typed_yaml import ConfigurationError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="A robot holds a 3D ultrasound probe, finds a needle and follows it.",
)
_console = Console()

JsonOption = Annotated[
    Path | None, typer.Option("--json", help="Also write what is printed to this file.")
]


@app.command("list")
def list_command(json_path: JsonOption = None) -> None:
    """List the scenarios that come with the package."""
    rows = {name: load_scenario(name).description for name in list_scenarios()}
    table = Table("scenario", "what happens")
    for name, description in rows.items():
        table.add_row(name, description)
    _console.print(table)
    _write_json(json_path, rows)


@app.command("run")
def run_command(
    scenario: Annotated[str, typer.Argument(help="A name from `sonoservo list`, or a YAML file.")],
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    meshcat: Annotated[bool, typer.Option(help="Show the run in a browser, at real time.")] = True,
    json_path: JsonOption = None,
) -> None:
    """Run a scenario; end with a table of figures and a folder of results."""
    loaded = load_scenario(scenario, changes=changes, seed=seed)
    folder = out or Path("out") / f"{loaded.name}_seed{loaded.seed}"
    display = start_display(_console) if meshcat else None
    with Progress(_console, loaded) as progress:
        result = run(loaded, out=folder, meshcat=display, after_volume=progress)
    _console.print(summary_table(result.summary, loaded.published))
    _console.print(f"Results, starting with the report: {folder / 'report.html'}", soft_wrap=True)
    _write_json(json_path, result.summary)
    if result.summary["interrupted"]:
        raise typer.Exit(130)


@app.command("scan")
def scan_command(
    scenario: Annotated[str, typer.Argument(help="A name from `sonoservo list`, or a YAML file.")],
    time: Annotated[
        float | None, typer.Option(help="When, in s; by default when the needle is deepest.")
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    json_path: JsonOption = None,
) -> None:
    """Show what the scanner sees: one sweep, as a picture and as a volume for 3D Slicer."""
    loaded = load_scenario(scenario, changes=changes, seed=seed)
    result = scan(loaded, time=time)
    summary = summarize_scan(result, loaded)
    folder = out or Path("out") / f"{loaded.name}_seed{loaded.seed}_scan"
    paths = write_scan(result, loaded, folder)
    _console.print(caption(result, loaded), soft_wrap=True)
    _console.print(
        f"At {summary['time_s']:.2f} s, {summary['inserted_mm']:.1f} mm of the needle are in the "
        f"tissue. Written: {', '.join(map(str, paths))}",
        soft_wrap=True,
    )
    _write_json(json_path, summary)


def _write_json(path: Path | None, data: Any) -> None:
    if path is not None:
        write_atomically(path, json.dumps(data, indent=2))


def main() -> None:
    """Run the command line; a user's mistake is one line and exit code 2."""
    try:
        app()
    except (ConfigurationError, OSError) as error:
        print(f"sonoservo: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
