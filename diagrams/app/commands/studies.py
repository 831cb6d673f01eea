"""Commands that make many runs: data sets, reproductions of papers, and the benchmark."""

import shlex
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from sonoservo.diagrams.app.options import (
    ChangesOption,
    Printed,
    Results,
    ScenarioArgument,
    Workers,
    console,
    refusing_values,
    say,
    say_report,
    write_printed,
)
from sonoservo.diagrams.papers.registry import ALL, STUDIES, reproduce, require_paper
from sonoservo.diagrams.published import PAPERS
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest

if TYPE_CHECKING:
    from sonoservo.diagrams.scenario import Scenario
    from sonoservo.diagrams.studies.study import Executor

_EPISODES = "lerobot"  # layout of whole runs, besides those of a data set


@contextmanager
def opened(workers: Workers) -> Iterator["Executor | None"]:
    """Open the cluster that the user named, if any."""
    from sonoservo.diagrams.studies.cluster.opening import open_cluster

    if workers.cluster is None:
        yield None
        return
    with open_cluster(workers.cluster, limit=workers.case_limit, notify=console.print) as executor:
        yield executor


def dataset_command(
    scenario: ScenarioArgument,
    count: Annotated[int, typer.Option(help="Number of sequences.")],
    out: Annotated[Path, typer.Option(help="Folder for the sequences and manifest.json.")],
    workers: Workers,
    printed: Printed,
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
        str,
        typer.Option(
            help=f"Layout of the files: sequences, nnunet, zea, or {_EPISODES}: episodes of runs."
        ),
    ] = "sequences",
    store: Annotated[
        str | None,
        typer.Option(help="Folder or fsspec URL for the sequences; by default, the one of --out."),
    ] = None,
) -> None:
    """Make labelled sequences of needles, tissues and probes drawn at random.

    Finished sequences are kept; repeat the command to resume after an interruption.
    """
    from sonoservo.diagrams.experiments.registry import load_scenario
    from sonoservo.diagrams.studies.datasets.dataset import make_dataset
    from sonoservo.diagrams.studies.datasets.dataset_sequence import LAYOUTS

    if layout not in (known := [*LAYOUTS, _EPISODES]):
        raise ConfigurationError(f"layout: {layout!r} is not allowed; {suggest(layout, known)}")
    loaded = load_scenario(scenario, changes=changes, seed=seed)
    if layout == _EPISODES:
        _make_episodes(loaded, out, count, workers, printed.json_path)
        return
    with opened(workers) as executor:
        manifest = make_dataset(
            loaded,
            out,
            count=count,
            volumes=volumes,
            transducers=transducers or (),
            randomize=randomize,
            layout=layout,
            store=store,
            jobs=workers.jobs,
            cluster=executor,
            console=console,
        )
    say(
        f"{len(manifest['sequences'])} sequences, {len(manifest['failed'])} failed: "
        f"{store or out}/manifest.json"
    )
    write_printed(printed.json_path, manifest)
    if manifest["failed"]:
        raise typer.Exit(1)


def _make_episodes(
    scenario: "Scenario",
    out: Path,
    count: int,
    workers: Workers,
    json_path: Path | None,
) -> None:
    """Write runs of a scenario as episodes of LeRobot."""
    from sonoservo.diagrams.studies.datasets.lerobot_episodes import make_episodes

    with opened(workers) as executor:
        info = make_episodes(
            scenario, out, count=count, jobs=workers.jobs, cluster=executor, console=console
        )
    say(f"{info['total_episodes']} episodes: {out}/meta/info.json")
    write_printed(json_path, info)
    if info["total_episodes"] < count:
        raise typer.Exit(1)


def reproduce_command(
    paper: Annotated[
        str,
        typer.Argument(
            help=f"Paper to reproduce: {', '.join(PAPERS)}, or all; or the study "
            f"{', '.join(STUDIES)}."
        ),
    ],
    workers: Workers,
    results: Results,
    quick: Annotated[
        bool, typer.Option("--quick", help="Make a few short runs only (minutes).")
    ] = False,
    seeds: Annotated[
        int | None, typer.Option(help="Largest number of seeds of an experiment.")
    ] = None,
    first_seed: Annotated[int, typer.Option(help="First seed.")] = 0,
    only: Annotated[
        str, typer.Option(help="Run only experiments whose names begin with this, such as open.")
    ] = "",
    finished: Annotated[
        bool, typer.Option("--finished", help="Report the finished runs, without making others.")
    ] = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the results in the repository, with its tables.")
    ] = False,
    add: Annotated[
        bool,
        typer.Option(
            "--add", help="Make the runs that are not kept yet, and keep them beside the others."
        ),
    ] = False,
    repeat: Annotated[
        int | None,
        typer.Option(min=1, help="Make this many of the kept runs again, and compare the figures."),
    ] = None,
    refresh: Annotated[
        bool,
        typer.Option(
            "--refresh",
            help="Make the kept runs again whose figures the present code changes, and keep them.",
        ),
    ] = False,
) -> None:
    """Repeat a paper's experiments over many seeds, and compare with its figures and the truth.

    The study `robustness` turns one dial of the harder world at a time, for three trackers.

    Finished runs are kept; repeat the command to resume after an interruption.
    """
    papers = PAPERS if paper == ALL else (paper,)
    for each in papers:
        require_paper(each)
    if repeat is not None:
        if quick or seeds or first_seed or only or finished or add or results.out:
            raise ConfigurationError(
                "--repeat: it takes the kept runs as they are; leave out --quick, --seeds, "
                "--first-seed, --only, --finished, --add and --out"
            )
        _repeat(papers, repeat, workers, results, keep=keep)
        return
    if refresh:
        if quick or seeds or first_seed or finished or add or keep:
            raise ConfigurationError(
                "--refresh: it takes the kept runs as they are, and keeps them; leave out --quick, "
                "--seeds, --first-seed, --finished, --add and --keep"
            )
        _refresh(papers, only, workers, results)
        return
    if (keep and (quick or first_seed or only)) or (add and quick):
        raise ConfigurationError(
            "--keep: no results of a quick study, of other seeds or of a part are kept; "
            "--add adds other seeds or a part"
        )
    with console.status(f"Preparing to reproduce {paper} ..."):  # seconds, where files are cold
        from sonoservo.diagrams.app.terminal import study_table
        from sonoservo.diagrams.papers.repeats import choose_missing
        from sonoservo.diagrams.papers.results import keep_records
        from sonoservo.diagrams.studies.processes import FinishedOnly
        from sonoservo.diagrams.studies.study import StudyOptions
        from sonoservo.diagrams.studies.study_report import write_studies, write_study

        choices = {each: choose_missing(each) if add else None for each in papers}
    folder = results.out or Path("out") / f"{paper}{'_quick' if quick else ''}"
    command = ["sonoservo", "reproduce", paper, *(["--quick"] if quick else [])]
    command += [] if seeds is None else ["--seeds", str(seeds)]
    command += ["--first-seed", str(first_seed)] if first_seed else []
    command += ["--only", only] if only else []
    command += ["--finished"] if finished else []
    command += [] if results.out is None else ["--out", str(results.out)]
    with refusing_values():
        options = StudyOptions(
            folder=folder,
            quick=quick,
            seeds=seeds,
            first_seed=first_seed,
            only=only,
            jobs=workers.jobs,
            console=console,
        )
    studies = []
    try:
        with nullcontext(FinishedOnly()) if finished else opened(workers) as executor:
            for each in papers:
                into = folder / each if paper == ALL else folder
                console.print(f"Reproducing {each} ...")
                own = replace(options, folder=into, cluster=executor, choose=choices[each])
                studies.append(reproduce(each, own))
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
    if keep or add:
        made = {each.paper: each.outcomes for each in studies}
        part = seeds is not None or first_seed or only or finished
        adds = ("part" if part else "rest") if add else ""
        keep_records(made, shlex.join(command), adds=adds)
    write_printed(results.json_path, data)


def _repeat(
    papers: Iterable[str], number: int, workers: Workers, results: Results, *, keep: bool
) -> None:
    """Make some kept runs of each paper again; exit status 1 if any gives other figures."""
    from sonoservo.diagrams.papers.repeats import repeat_kept_runs
    from sonoservo.diagrams.papers.results import keep_repeat
    from sonoservo.diagrams.studies.study import StudyOptions

    made = {}
    for paper in papers:
        with opened(workers) as executor, TemporaryDirectory() as folder:
            with refusing_values():
                options = StudyOptions(
                    folder=Path(folder), jobs=workers.jobs, cluster=executor, console=console
                )
            made[paper] = repeat_kept_runs(paper, number, options)
        differ = [each for each in made[paper] if each.difference]
        for each in differ:
            say(f"{each.name}: {each.difference}")
        same = len(made[paper]) - len(differ)
        say(f"{paper}: {same} of {len(made[paper])} kept runs gave the same figures again")
        if keep and not differ:
            keep_repeat(paper, same)
    rows = {paper: [asdict(each) for each in repeats] for paper, repeats in made.items()}
    write_printed(results.json_path, rows)
    if any(each.difference for repeats in made.values() for each in repeats):
        raise typer.Exit(1)


def _refresh(papers: Iterable[str], only: str, workers: Workers, results: Results) -> None:
    """Make those kept runs of each paper again that the present code changes, and keep them."""
    from sonoservo.diagrams.papers.repeats import refresh_kept_runs
    from sonoservo.diagrams.papers.results import keep_refreshed, require_keepable
    from sonoservo.diagrams.studies.study import StudyOptions

    require_keepable()
    made = {}
    for paper in papers:
        folder = (results.out or Path("out")) / f"{paper}_refreshed"
        console.print(f"Refreshing {paper} ...")
        with opened(workers) as executor:
            with refusing_values():
                options = StudyOptions(
                    folder=folder, only=only, jobs=workers.jobs, cluster=executor, console=console
                )
            found = refresh_kept_runs(paper, options)
        keep_refreshed(paper, found.outcomes, found.same, whole=not only)
        experiments = dict.fromkeys(each.case.experiment for each in found.outcomes)
        say(
            f"{paper}: {len(found.outcomes)} runs of {len(experiments)} experiments are kept anew; "
            f"{found.same} runs of the others gave the same figures again"
        )
        made[paper] = {"experiments": list(experiments), "same": found.same}
    write_printed(results.json_path, made)


MAKE = "make"
"""First argument that asks for the volumes instead of scores."""


def benchmark_command(
    workers: Workers,
    results: Results,
    trackers: Annotated[
        list[str] | None,
        typer.Argument(
            help="Trackers: names of ours, brightest_line, module:factory, or folders of tables; "
            "or the word make, to write the volumes."
        ),
    ] = None,
    suites: Annotated[
        list[str] | None, typer.Option("--suite", help="Suite to take; repeatable. All by default.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="One sequence of each suite: the small subset.")
    ] = False,
    salt: Annotated[
        int, typer.Option(help="Draw other sequences; 0 are those on which results are reported.")
    ] = 0,
    sequences: Annotated[
        int | None, typer.Option(help="Number of sequences in a suite, up to 20.")
    ] = None,
    formats: Annotated[
        list[str] | None,
        typer.Option("--format", help="make: nrrd, zea; repeatable. Both by default."),
    ] = None,
    store: Annotated[
        str | None, typer.Option(help="make: folder or fsspec URL that a cluster writes to.")
    ] = None,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the scores in the repository, with their tables.")
    ] = False,
) -> None:
    """Score needle trackers on suites of simulated volumes, or make the volumes.

    Finished sequences are kept; repeat the command to resume after an interruption.
    """
    from sonoservo.diagrams.benchmark.benchmark import (
        KEPT_TRACKERS,
        BenchmarkOptions,
        run_benchmark,
    )
    from sonoservo.diagrams.benchmark.making import FORMATS, make_volumes
    from sonoservo.diagrams.benchmark.report import benchmark_table, write_benchmark
    from sonoservo.diagrams.papers.results import BENCHMARK, keep_records

    if keep and (trackers or suites or quick or salt):
        raise ConfigurationError(
            "--keep: only scores of the four kept trackers on the reported sequences are kept"
        )
    names = list(trackers or (KEPT_TRACKERS if keep else KEPT_TRACKERS[:2]))
    makes = names == [MAKE]
    if MAKE in names and not makes:
        raise ConfigurationError("make: it takes no trackers; score them in a second command")
    if not makes and (formats or store):
        raise ConfigurationError("--format, --store: only for `sonoservo benchmark make`")
    folder = results.out or Path("out") / ("benchmark_volumes" if makes else "benchmark")
    command = shlex.join(["sonoservo", *sys.argv[1:]])
    with opened(workers) as executor:
        options = BenchmarkOptions(
            folder=folder,
            suites=suites or (),
            quick=quick,
            salt=salt,
            sequences=sequences,
            jobs=workers.jobs,
            cluster=executor,
            console=console,
        )
        if makes:
            outcomes = make_volumes(options, tuple(formats or FORMATS), store)
            failed = [each for each in outcomes if not each]
            say(
                f"{len(outcomes) - len(failed)} sequences, {len(failed)} failed: {folder}/README.md"
            )
            write_printed(results.json_path, [dict(each.result) for each in outcomes if each])
        else:
            result = run_benchmark(names, options)
            write_benchmark(result, folder, command)
            console.print(benchmark_table(result.data).terminal(widest=None))
            say_report(folder)
            write_printed(results.json_path, result.data)
            failed = result.failed
            if keep:
                keep_records({BENCHMARK: result.outcomes}, command)
    for each in failed:
        console.print(f"{each.case.experiment}, seed {each.case.seed}: {each.error}")
    if failed:
        raise typer.Exit(1)
