"""The command that scores trackers, and makes the volumes to score them on."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from sonoservo.diagrams.app.commands.studies import opened
from sonoservo.diagrams.app.options import (
    Results,
    Workers,
    console,
    say_report,
    write_printed,
)
from sonoservo.systems.files.refusals import ConfigurationError

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
) -> None:
    """Score needle trackers on suites of simulated volumes, or make the volumes.

    Finished sequences are kept; repeat the command to resume after an interruption.
    """
    from sonoservo.diagrams.benchmark.benchmark import BenchmarkOptions, run_benchmark
    from sonoservo.diagrams.benchmark.making import FORMATS, make_volumes
    from sonoservo.diagrams.benchmark.report import benchmark_table, write_benchmark

    names = trackers or ["chatelain2013", "brightest_line"]
    makes = names == [MAKE]
    if MAKE in names and not makes:
        raise ConfigurationError("make: it takes no trackers; score them in a second command")
    if not makes and (formats or store):
        raise ConfigurationError("--format, --store: only for `sonoservo benchmark make`")
    folder = results.out or Path("out") / ("benchmark_volumes" if makes else "benchmark")
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
            console.print(
                f"{len(outcomes) - len(failed)} sequences, {len(failed)} failed: "
                f"{folder}/README.md",
                soft_wrap=True,
            )
            write_printed(results.json_path, [dict(each.result) for each in outcomes if each])
        else:
            result = run_benchmark(names, options)
            write_benchmark(result, folder, shlex.join(["sonoservo", *sys.argv[1:]]))
            console.print(benchmark_table(result.data).transposed().terminal(widest=None))
            say_report(folder)
            write_printed(results.json_path, result.data)
            failed = result.failed
    for each in failed:
        console.print(f"{each.case.experiment}, seed {each.case.seed}: {each.error}")
    if failed:
        raise typer.Exit(1)
