"""Commands that make many runs: data sets, and reproductions of papers."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from sonoservo.diagrams.app.options import (
    ChangesOption,
    JobsOption,
    JsonOption,
    OutOption,
    ScenarioArgument,
    console,
    write_printed,
)
from sonoservo.diagrams.papers.registry import PAPERS, reproduce, require_paper
from sonoservo.systems.files.refusals import ConfigurationError


def dataset_command(
    scenario: ScenarioArgument,
    count: Annotated[int, typer.Option(help="Number of sequences.")],
    out: Annotated[Path, typer.Option(help="Folder for the sequences and manifest.json.")],
    volumes: Annotated[int, typer.Option(help="Number of volumes in each sequence.")] = 10,
    transducers: Annotated[
        list[str] | None, typer.Option("--transducer", help="Probe to draw from; repeatable.")
    ] = None,
    changes: ChangesOption = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the first sequence.")] = None,
    jobs: JobsOption = -1,
    json_path: JsonOption = None,
) -> None:
    """Make labelled sequences of needles, tissues and probes drawn at random.

    Finished sequences are kept; repeat the command to resume after an interruption.
    """
    from sonoservo.diagrams.experiments.registry import load_scenario
    from sonoservo.diagrams.studies.dataset import make_dataset

    loaded = load_scenario(scenario, changes=changes, seed=seed)
    manifest = make_dataset(
        loaded,
        out,
        count=count,
        volumes=volumes,
        transducers=transducers or (),
        jobs=jobs,
        console=console,
    )
    console.print(
        f"{len(manifest['sequences'])} sequences, {len(manifest['failed'])} failed: "
        f"{out / 'manifest.json'}",
        soft_wrap=True,
    )
    write_printed(json_path, manifest)
    if manifest["failed"]:
        raise typer.Exit(1)


def reproduce_command(
    paper: Annotated[str, typer.Argument(help=f"Paper to reproduce: {', '.join(PAPERS)}.")],
    quick: Annotated[
        bool, typer.Option("--quick", help="Make a few short runs only (minutes).")
    ] = False,
    seeds: Annotated[int | None, typer.Option(help="Number of seeds per experiment.")] = None,
    first_seed: Annotated[int, typer.Option(help="First seed.")] = 0,
    out: OutOption = None,
    jobs: JobsOption = -1,
    json_path: JsonOption = None,
) -> None:
    """Repeat a paper's experiments over many seeds, and compare with its figures and the truth.

    Finished runs are kept; repeat the command to resume after an interruption.
    """
    from sonoservo.diagrams.app.terminal import study_table
    from sonoservo.diagrams.studies.study import StudyOptions
    from sonoservo.diagrams.studies.study_report import write_study

    require_paper(paper)
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
            console=console,
        )
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    try:
        study = reproduce(paper, options)
    except KeyboardInterrupt:
        console.print(f"Interrupted. Finished runs are in {folder}; repeat the command to resume.")
        raise
    console.print(study_table(study))  # before its files, which a full disk would prevent
    data = write_study(folder, study, shlex.join(command))
    console.print(f"Report: {folder / 'report.html'}", soft_wrap=True)
    write_printed(json_path, data)
