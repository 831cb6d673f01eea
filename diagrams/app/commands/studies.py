"""Commands that make many runs: data sets, and reproductions of papers."""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sonoservo.diagrams.app.options import (
    CaseLimitOption,
    ChangesOption,
    ClusterOption,
    JobsOption,
    JsonOption,
    OutOption,
    ScenarioArgument,
    console,
    say_report,
    write_printed,
)
from sonoservo.diagrams.papers.registry import ALL, STUDIES, reproduce, require_paper
from sonoservo.diagrams.published import PAPERS
from sonoservo.diagrams.studies.cluster.opening import CASE_LIMIT_S
from sonoservo.diagrams.studies.progress import Heartbeat
from sonoservo.systems.files.refusals import ConfigurationError

if TYPE_CHECKING:
    from sonoservo.diagrams.studies.study import Executor


@contextmanager
def opened(cluster: str | None, case_limit: float) -> Iterator["Executor | None"]:
    """Open the cluster that the user named, if any."""
    from sonoservo.diagrams.studies.cluster.opening import open_cluster

    if cluster is None:
        yield None
        return
    with open_cluster(cluster, limit=case_limit, notify=console.print) as executor:
        yield executor


def dataset_command(
    scenario: ScenarioArgument,
    count: Annotated[int, typer.Option(help="Number of sequences.")],
    out: Annotated[Path, typer.Option(help="Folder for the sequences and manifest.json.")],
    volumes: Annotated[int, typer.Option(help="Number of volumes in each sequence.")] = 10,
    transducers: Annotated[
        list[str] | None, typer.Option("--probe", help="Probe to draw from; repeatable.")
    ] = None,
    changes: ChangesOption = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the first sequence.")] = None,
    randomize: Annotated[
        bool,
        typer.Option("--randomize", help="Also draw the dials that `sonoservo list` names."),
    ] = False,
    layout: Annotated[
        str, typer.Option(help="Layout of the files: sequences, nnunet or zea.")
    ] = "sequences",
    store: Annotated[
        str | None,
        typer.Option(help="Folder or fsspec URL for the sequences; by default, the one of --out."),
    ] = None,
    jobs: JobsOption = -1,
    cluster: ClusterOption = None,
    case_limit: CaseLimitOption = CASE_LIMIT_S,
    json_path: JsonOption = None,
) -> None:
    """Make labelled sequences of needles, tissues and probes drawn at random.

    Finished sequences are kept; repeat the command to resume after an interruption.
    """
    from sonoservo.diagrams.experiments.registry import load_scenario
    from sonoservo.diagrams.studies.datasets.dataset import make_dataset

    loaded = load_scenario(scenario, changes=changes, seed=seed)
    with opened(cluster, case_limit) as executor:
        manifest = make_dataset(
            loaded,
            out,
            count=count,
            volumes=volumes,
            transducers=transducers or (),
            randomize=randomize,
            layout=layout,
            store=store,
            jobs=jobs,
            cluster=executor,
            console=console,
        )
    console.print(
        f"{len(manifest['sequences'])} sequences, {len(manifest['failed'])} failed: "
        f"{store or out}/manifest.json",
        soft_wrap=True,
    )
    write_printed(json_path, manifest)
    if manifest["failed"]:
        raise typer.Exit(1)


def reproduce_command(
    paper: Annotated[
        str,
        typer.Argument(
            help=f"Paper to reproduce: {', '.join(PAPERS)}; or all of them: all. Or a study of no "
            f"paper: {', '.join(STUDIES)}."
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Make a few short runs only (minutes).")
    ] = False,
    seeds: Annotated[
        int | None, typer.Option(help="Largest number of seeds of an experiment.")
    ] = None,
    first_seed: Annotated[int, typer.Option(help="First seed.")] = 0,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the results in the repository, with its tables.")
    ] = False,
    out: OutOption = None,
    jobs: JobsOption = -1,
    cluster: ClusterOption = None,
    case_limit: CaseLimitOption = CASE_LIMIT_S,
    json_path: JsonOption = None,
) -> None:
    """Repeat a paper's experiments over many seeds, and compare with its figures and the truth.

    The study `robustness` turns one dial of the harder world at a time, for three trackers.

    Finished runs are kept; repeat the command to resume after an interruption.
    """
    papers = PAPERS if paper == ALL else (paper,)
    for each in papers:
        require_paper(each)
    if keep and (quick or first_seed):
        raise ConfigurationError("--keep: no results of a quick study or of other seeds are kept")
    with Heartbeat(console, f"Preparing to reproduce {paper}"):  # seconds, where files are cold
        from sonoservo.diagrams.app.terminal import study_table
        from sonoservo.diagrams.papers.results import keep_results
        from sonoservo.diagrams.studies.study import StudyOptions
        from sonoservo.diagrams.studies.study_report import write_studies, write_study
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
    studies = []
    try:
        with opened(cluster, case_limit) as executor:
            for each in papers:
                into = folder / each if paper == ALL else folder
                with Heartbeat(console, f"Reproducing {each}"):
                    studies.append(reproduce(each, replace(options, folder=into, cluster=executor)))
                # before its files, which a full disk would prevent
                console.print(study_table(studies[-1], console.width))
    except KeyboardInterrupt:
        console.print(f"Interrupted. Finished runs are in {folder}; repeat the command to resume.")
        raise
    if paper == ALL:
        data = write_studies(folder, studies, shlex.join(command))
    else:
        data = write_study(folder, studies[0], shlex.join(command))
    say_report(folder)
    if keep:
        keep_results(studies, shlex.join(command))
    write_printed(json_path, data)
