"""The command line of ``sonoservo``: one function a command."""

import shlex
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from sonoservo.diagrams.app.drive import DRIVING, drive
from sonoservo.diagrams.app.kept_run import refusing
from sonoservo.diagrams.app.live import bridge_files, needle_names, serving, track_address
from sonoservo.diagrams.app.locate import locate_in_recording
from sonoservo.diagrams.app.run import run
from sonoservo.diagrams.app.scan import caption, scan, summarize_scan, write_scan
from sonoservo.diagrams.app.shape_run import predict_shape
from sonoservo.diagrams.app.terminal import (
    Progress,
    VolumeProgress,
    keep_shown,
    mode_table,
    start_display,
    start_monitor,
    study_table,
    summary_table,
)
from sonoservo.diagrams.app.track import track_recording, tracker_parameters
from sonoservo.diagrams.app.track_live import LiveLimits
from sonoservo.diagrams.scenario import list_scenarios, load_any_scenario, load_scenario
from sonoservo.diagrams.shape_scenario import ShapeScenario
from sonoservo.diagrams.studies.dataset import make_dataset
from sonoservo.diagrams.studies.study import StudyOptions
from sonoservo.diagrams.studies.study_report import write_study
from sonoservo.systems.files.typed_yaml import ConfigurationError, suggest
from sonoservo.systems.files.writing import write_json
from sonoservo.systems.live.protocols import is_address
from sonoservo.systems.recording.recording import Recording

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="A robot holds a 3D ultrasound probe, finds a needle and follows it.",
)
_console = Console()

_PAPERS = ("carriere2016", "chatelain2013", "zhao2012")
"""Modules of `sonoservo.diagrams`, each with ``reproduce(options: StudyOptions) -> Study``."""

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
    float | None, typer.Option(help="dB from black to white; 60 unless the recorder noted it.")
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
    typer.Option(help="Send all of it live: igtl://:18944 lets others on this machine connect."),
]
WaitOption = Annotated[int, typer.Option(help="Live: begin when so many others are connected.")]
VolumesOption = Annotated[int | None, typer.Option(help="Live: end after so many volumes.")]
PatienceOption = Annotated[
    float | None, typer.Option(help="Live: end when none has come for so long, in s.")
]


@app.command("list")
def list_command(json_path: JsonOption = None) -> None:
    """List the scenarios that come with the package."""
    rows = {name: load_any_scenario(name).description for name in list_scenarios()}
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
    host: HostOption = "localhost",
    record: Annotated[
        Path | None, typer.Option(help="Record the volumes, with the truth: FILE.seq.nrrd.")
    ] = None,
    record_sweeps: Annotated[
        bool, typer.Option("--record-sweeps", help="Record the sweeps too, as acquired.")
    ] = False,
    serve: ServeOption = None,
    wait_for: WaitOption = 0,
    json_path: JsonOption = None,
) -> None:
    """Run a scenario; end with a table of figures and a folder of results."""
    loaded = load_any_scenario(scenario, changes=changes, seed=seed)
    if isinstance(loaded, ShapeScenario) and (record or record_sweeps):
        raise ConfigurationError(f"--record: {loaded.name} makes slices, no volumes")
    if isinstance(loaded, ShapeScenario) and serve:
        raise ConfigurationError(f"--serve: {loaded.name} makes slices, no volumes")
    folder = out or Path("out") / f"{loaded.name}_seed{loaded.seed}"
    makes_volumes = not isinstance(loaded, ShapeScenario)
    monitor = start_monitor(_console, host) if meshcat and makes_volumes else None
    display = start_display(_console, host) if meshcat else None
    with Progress(_console, loaded) as progress:
        if isinstance(loaded, ShapeScenario):
            summary = predict_shape(
                loaded, out=folder, meshcat=display, after_slice=progress.show_slice
            ).summary
            published = loaded.published_figures
        else:
            with serving(_console, serve, loaded, wait_for) as observers:
                summary = run(
                    loaded,
                    out=folder,
                    meshcat=display,
                    monitor=monitor,
                    after_volume=progress,
                    record=record,
                    record_sweeps=record_sweeps,
                    observers=observers,
                ).summary
            published = loaded.published
    _console.print(summary_table(summary, published))
    _console.print(f"Results, starting with the report: {folder / 'report.html'}", soft_wrap=True)
    _write_json(json_path, summary)
    if summary["interrupted"]:
        raise typer.Exit(130)


@app.command("drive")
def drive_command(
    scenario: Annotated[
        str, typer.Argument(help="A name from `sonoservo list`, or a YAML file.")
    ] = "drive",
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    duration: Annotated[float, typer.Option(help="Longest simulated time, in s.")] = 600.0,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    host: HostOption = "localhost",
    serve: ServeOption = None,
    json_path: JsonOption = None,
) -> None:
    """Push the needle, move the phantom and set the controller yourself, in a browser.

    The scenario's own pushes, moves and changes are left out. What you do is kept as scenario.yaml,
    which `sonoservo run` repeats. Finish in the page, or with Ctrl-C.
    """
    loaded = load_scenario(scenario, changes=changes, seed=seed)
    with refusing(loaded):
        loaded = replace(loaded, duration=duration)
    folder = out or Path("out") / f"{loaded.name}_driven_seed{loaded.seed}"
    monitor = start_monitor(_console, host)
    display = start_display(_console, host)
    _console.print(DRIVING)
    with Progress(_console, loaded) as progress, serving(_console, serve, loaded) as observers:
        summary = drive(
            loaded, display, monitor=monitor, observers=observers, out=folder, show=progress.show
        ).summary
    _console.print(summary_table(summary, {}))
    _console.print(f"Results, starting with the report: {folder / 'report.html'}", soft_wrap=True)
    again = f"sonoservo run {folder / 'scenario.yaml'}"
    _console.print(f"The same again: {again}", soft_wrap=True)
    _write_json(json_path, summary)


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


@app.command("track")
def track_command(
    source: Annotated[
        str,
        typer.Argument(
            help="Recorded volumes: .seq.nrrd, .nrrd, .nhdr, .mha or .mhd; or live ones: "
            "igtl://host:18944/DEVICE, igtl://:18944 to be connected to."
        ),
    ],
    tracker: Annotated[str, typer.Option(help="chatelain2013 or zhao2012.")] = "chatelain2013",
    order: OrderOption = 2,
    start: Annotated[
        str,
        typer.Option(help="search: find it when pushed in; anywhere: seek it in whole volumes."),
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
    serve: Annotated[
        list[str] | None,
        typer.Option(
            help="Live: where to send the estimates; the source's own address answers it."
        ),
    ] = None,
    names: Annotated[
        list[str] | None,
        typer.Option("--name", help="Live: a device's name: tip=, curve=, status=, covariance=."),
    ] = None,
    points: Annotated[
        bool, typer.Option("--points", help="Live: send control points (POINT), not a line.")
    ] = False,
    volumes: VolumesOption = None,
    patience: PatienceOption = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    json_path: JsonOption = None,
) -> None:
    """Track a needle through recorded or live volumes; end with a folder of results."""
    parameters = tracker_parameters(tracker, order=order, start=start)
    if is_address(source):
        summary = track_address(
            _console,
            source,
            parameters=parameters,
            depth=depth,
            window=window,
            poses=poses,
            dynamic_range_db=dynamic_range_db,
            seed=seed,
            monitor=start_monitor(_console, host) if show else None,
            serve=serve or [],
            names=needle_names(names or [], points=points),
            limits=LiveLimits(volumes=volumes, patience=patience),
            out=out,
        )
        _write_json(json_path, summary)
        return
    recording = Path(source)
    opened = Recording(recording, depth=depth, window=window, volume_rate=volume_rate, poses=poses)
    folder = out or Path("out") / f"{recording.name.partition('.')[0]}_track"
    monitor = start_monitor(_console, host) if show else None
    with VolumeProgress(_console, recording.name, len(opened)) as progress:
        result = track_recording(
            opened,
            parameters=parameters,
            dynamic_range_db=dynamic_range_db,
            seed=seed,
            real_time=real_time,
            monitor=monitor,
            out=folder,
            command=shlex.join(["sonoservo", *sys.argv[1:]]),
            after_volume=progress,
        )
    _console.print(mode_table(result.summary))
    _console.print(f"Results, starting with the report: {folder / 'report.html'}", soft_wrap=True)
    _write_json(json_path, result.summary)
    if monitor is not None and not result.summary["interrupted"]:
        keep_shown(_console)
    if result.summary["interrupted"]:
        raise typer.Exit(130)


@app.command("bridge")
def bridge_command(
    source: Annotated[str, typer.Argument(help="An address to record from, or a recording.")],
    target: Annotated[str, typer.Argument(help="NAME.seq.nrrd, or an address to play to.")],
    depth: DepthOption = "P",
    window: WindowOption = None,
    poses: PosesOption = None,
    speed: Annotated[
        float, typer.Option(help="Of playing; 0 for as fast as the slowest peer takes it.")
    ] = 1.0,
    wait_for: WaitOption = 1,
    volumes: VolumesOption = None,
    patience: PatienceOption = None,
    json_path: JsonOption = None,
) -> None:
    """Record a live connection, or play a recording as a scanner."""
    summary = bridge_files(
        _console,
        source,
        target,
        depth=depth,
        window=window,
        poses=poses,
        speed=speed,
        wait_for=wait_for,
        limits=LiveLimits(volumes=volumes, patience=patience),
    )
    _write_json(json_path, summary)
    if summary["interrupted"]:
        raise typer.Exit(130)


@app.command("locate")
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
    # Neither times nor poses matter for a single volume.
    opened = Recording(volume, depth=depth, window=window, volume_rate=1.0, poses="none")
    found = locate_in_recording(opened, number, order=order, dynamic_range_db=dynamic_range_db)
    for name, value in found.items():
        shown = np.round(value, 3).tolist() if isinstance(value, list | float) else value
        _console.print(f"{name}: {shown}", soft_wrap=True, highlight=False)
    _write_json(json_path, found)
    if not found["found"]:
        raise typer.Exit(1)


@app.command("dataset")
def dataset_command(
    scenario: Annotated[str, typer.Argument(help="A name from `sonoservo list`, or a YAML file.")],
    count: Annotated[int, typer.Option(help="Number of sequences.")],
    out: Annotated[Path, typer.Option(help="Folder for the sequences and manifest.json.")],
    volumes: Annotated[int, typer.Option(help="In each sequence.")] = 10,
    transducers: Annotated[
        list[str] | None, typer.Option("--transducer", help="One to choose from; again for more.")
    ] = None,
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="Change a field: path.to.field=value.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of the first sequence.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes; -1 means one for each core.")] = -1,
    json_path: JsonOption = None,
) -> None:
    """Make labelled sequences of needles, tissues and probes drawn at random.

    What is done is kept: the same command goes on where it was interrupted.
    """
    loaded = load_scenario(scenario, changes=changes, seed=seed)
    manifest = make_dataset(
        loaded,
        out,
        count=count,
        volumes=volumes,
        transducers=transducers or (),
        jobs=jobs,
        console=_console,
    )
    _console.print(
        f"{len(manifest['sequences'])} sequences, {len(manifest['failed'])} failed: "
        f"{out / 'manifest.json'}",
        soft_wrap=True,
    )
    _write_json(json_path, manifest)
    if manifest["failed"]:
        raise typer.Exit(1)


@app.command("reproduce")
def reproduce_command(
    paper: Annotated[str, typer.Argument(help=f"One of {', '.join(_PAPERS)}.")],
    quick: Annotated[bool, typer.Option("--quick", help="A few short runs, in minutes.")] = False,
    seeds: Annotated[int | None, typer.Option(help="Number of seeds of each experiment.")] = None,
    first_seed: Annotated[int, typer.Option(help="The first of them.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    jobs: Annotated[int, typer.Option(help="Processes; -1 means one for each core.")] = -1,
    json_path: JsonOption = None,
) -> None:
    """Repeat a paper's experiments over many seeds, beside its figures and the truth.

    What is done is kept: the same command goes on where it was interrupted.
    """
    if paper not in _PAPERS:
        raise ConfigurationError(f"unknown paper {paper!r}; {suggest(paper, _PAPERS)}")
    folder = out or Path("out") / f"{paper}{'_quick' if quick else ''}"
    command = ["sonoservo", "reproduce", paper, *(["--quick"] if quick else [])]
    command += [] if seeds is None else ["--seeds", str(seeds)]
    command += ["--first-seed", str(first_seed)] if first_seed else []
    command += [] if out is None else ["--out", str(out)]
    try:
        options = StudyOptions(
            folder=folder,
            quick=quick,
            seeds=seeds,
            first_seed=first_seed,
            jobs=jobs,
            console=_console,
        )
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    try:
        study = import_module(f"sonoservo.diagrams.papers.{paper}.reproduce").reproduce(options)
    except KeyboardInterrupt:
        _console.print(f"Interrupted. What is done is in {folder}; the same command goes on.")
        raise
    data = write_study(folder, study, shlex.join(command))
    _console.print(study_table(study))
    _console.print(f"Results, starting with the report: {folder / 'report.html'}", soft_wrap=True)
    _write_json(json_path, data)


def _write_json(path: Path | None, data: Any) -> None:
    if path is not None:
        write_json(path, data)


def main() -> None:
    """Run the command line; a user's mistake is one line and exit code 2."""
    try:
        app()
    except (ConfigurationError, OSError) as error:
        print(f"sonoservo: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
