"""The command line of ``sonoservo``, and its commands on one scenario.

A command imports what it needs only when it is called, so that help appears at once.
"""

import os
import re
import shlex
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.main import get_command

from sonoservo.diagrams.app.commands.results import (
    compare_command,
    explain_command,
    list_command,
    new_command,
    replay_command,
    show_command,
)
from sonoservo.diagrams.app.commands.studies import (
    benchmark_command,
    dataset_command,
    reproduce_command,
)
from sonoservo.diagrams.app.commands.volumes import (
    bridge_command,
    calibrate_command,
    check_command,
    locate_command,
    track_command,
)
from sonoservo.diagrams.app.interruption import INTERRUPTED, is_interrupted
from sonoservo.diagrams.app.options import (
    ChangesOption,
    ExplainOption,
    LogOption,
    Page,
    Results,
    ScenarioArgument,
    SeedOption,
    Serving,
    console,
    free_folder,
    say,
    say_probe,
    say_report,
    waiting,
    with_common_options,
    write_printed,
)
from sonoservo.systems.files.refusals import ConfigurationError, describe, shorten

if TYPE_CHECKING:
    from sonoservo.diagrams.app.pages.pages import Pages
    from sonoservo.diagrams.app.run_result import RunResult
    from sonoservo.diagrams.app.viewed_run import ViewedRun
    from sonoservo.diagrams.scenario import Scenario

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"sonoservo {version('sonoservo')}")
        raise typer.Exit


@app.callback()
def _program(
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """A robot holds a 3D ultrasound probe, finds a needle and follows it."""


def compile_command(
    everything: Annotated[
        bool, typer.Option("--all", help="Also what `clinic` and shape prediction need.")
    ] = False,
) -> None:
    """Compile the kernels beforehand; otherwise the first run does, in about a minute."""
    from sonoservo.diagrams.app.compile import compile_kernels

    with waiting("Loading the kernels; compiling what is missing takes up to a minute ..."):
        for line in compile_kernels(everything=everything):
            console.print(line)


def run_command(
    page: Page,
    serve: Serving,
    results: Results,
    scenario: ScenarioArgument = "chatelain2013_fig5",
    changes: ChangesOption = None,
    seed: SeedOption = None,
    meshcat: Annotated[bool, typer.Option(help="Show the run in a browser, in real time.")] = True,
    record: Annotated[
        Path | None, typer.Option(help="Record the volumes and the truth to NAME.seq.nrrd.")
    ] = None,
    record_sweeps: Annotated[
        bool, typer.Option("--record-sweeps", help="Also record the sweeps as acquired.")
    ] = False,
    as_published: Annotated[
        bool,
        typer.Option(
            "--as-published", help="Tracker, controller and estimator as the paper printed them."
        ),
    ] = False,
    replay: Annotated[
        bool,
        typer.Option("--replay", help="Write replay.html, the run in 3D, even without a page."),
    ] = False,
    movie: Annotated[
        Path | None, typer.Option(help="Movie of slices and curves: NAME.gif or NAME.mp4.")
    ] = None,
    explain: ExplainOption = False,
    log: LogOption = None,
    click: Annotated[
        bool, typer.Option("--click", help="Shape prediction: click on the needle at the start.")
    ] = False,
) -> None:
    """Run a scenario and write its results; exit status 3: stopped for good, or no contact."""
    with console.status("Loading the simulator ..."):
        from sonoservo.diagrams.app.own_tracker import without_own_tracker
        from sonoservo.diagrams.app.run import run
        from sonoservo.diagrams.app.terminal import end_run
        from sonoservo.diagrams.app.viewed_run import ViewedRun
        from sonoservo.diagrams.experiments.registry import load_scenario

        fields, own = without_own_tracker(changes)
        loaded = load_scenario(scenario, changes=fields, seed=seed, as_published=as_published)
    if isinstance(probe := getattr(loaded, "probe", None), str):  # not of all experiments
        say_probe(probe)
    viewed = ViewedRun(log, loaded)
    folder = results.out or free_folder(f"{loaded.name}_seed{loaded.seed}")
    if click:
        from sonoservo.diagrams.app.pages.first_click import ask_click

        loaded = ask_click(loaded, console, page)
    pages = None
    if meshcat:
        from sonoservo.diagrams.app.pages.pages import open_pages

        pages = open_pages(f"{loaded.name}, seed {loaded.seed}", page)
    act = partial(
        run,
        loaded,
        out=folder,
        meshcat=pages.meshcat if pages else None,
        console=pages.console if pages else None,
        replay=replay,
        movie=movie,
        record=record,
        record_sweeps=record_sweeps,
        explain=explain,
        tracker=own,
        after_step=viewed,
        progress=console,
    )
    result = _carry_out(act, loaded, folder, viewed, serve, pages, results)
    if not result.failure and result.summary["interrupted"]:
        raise typer.Exit(INTERRUPTED)
    end_run(result)


def _carry_out(
    act: "Callable[..., RunResult]",
    scenario: "Scenario",
    folder: Path,
    viewed: "ViewedRun",
    serve: Serving,
    pages: "Pages | None",
    results: Results,
    *,
    how: str = "",
    again: str = "",
) -> "RunResult":
    """Carry out a run, tell its figures and where its report is, and end its pages."""
    from sonoservo.diagrams.app.live.serve import serving
    from sonoservo.diagrams.app.run_result import end_words, summary_table

    with serving(serve, scenario, say) as (observers, await_peers):

        def begin() -> None:
            await_peers()
            if pages:
                pages.announce(console)
            if how:
                console.print(how)

        result = act(observers=observers, begin=begin)
    viewed.end(result.log)
    console.print(summary_table(result))
    say_report(folder)
    if again:
        say(again)
    write_printed(results.json_path, result.summary)
    if pages:
        pages.end(console, end_words(result), folder / "report.html")
    return result


def drive_command(
    page: Page,
    serve: Serving,
    results: Results,
    scenario: ScenarioArgument = "drive",
    changes: ChangesOption = None,
    seed: SeedOption = None,
    duration: Annotated[float, typer.Option(help="Maximum simulated time, in s.")] = 600.0,
    log: LogOption = None,
) -> None:
    """Push the needle, move the phantom and set the controller yourself, in a browser.

    The scenario's own pushes, moves and changes are ignored. Your actions are saved as
    scenario.yaml in the output folder; `sonoservo run` repeats them. Finish in the page or with
    Ctrl-C. Exit status 3: the guard stopped the robot for good, or there was no contact.
    """
    with console.status("Loading the simulator ..."):
        from sonoservo.diagrams.app.drive import DRIVING, drive
        from sonoservo.diagrams.app.kept_runs.kept_run import refusing
        from sonoservo.diagrams.app.own_tracker import without_own_tracker
        from sonoservo.diagrams.app.pages.pages import open_pages
        from sonoservo.diagrams.app.terminal import end_run
        from sonoservo.diagrams.app.viewed_run import ViewedRun
        from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
        from sonoservo.diagrams.experiments.registry import load_scenario
        from sonoservo.diagrams.scenario import require_scenario

        fields, own = without_own_tracker(changes)
        loaded = load_scenario(scenario, changes=fields, seed=seed)
    following = require_scenario(loaded, FollowingScenario)
    with refusing(loaded):
        following = replace(following, duration=duration)
    say_probe(following.probe)
    viewed = ViewedRun(log, following)
    folder = results.out or free_folder(f"{loaded.name}_driven_seed{loaded.seed}")
    pages = open_pages(f"{loaded.name}, driven", page)
    act = partial(
        drive,
        following,
        pages.console,
        meshcat=pages.meshcat,
        tracker=own,
        out=folder,
        progress=console,
    )
    command = shlex.join(["sonoservo", "run", str(folder / "scenario.yaml")])
    again = f"To repeat this run: {command}"
    end_run(
        _carry_out(act, following, folder, viewed, serve, pages, results, how=DRIVING, again=again)
    )


def scan_command(
    results: Results,
    scenario: Annotated[
        str | None,
        typer.Argument(help="A name from `sonoservo list`, or a YAML file; fig. 5 by default."),
    ] = None,
    phantom: Annotated[
        str | None,
        typer.Option(help="Another phantom: a name, a YAML file or a label map (NRRD, NIfTI)."),
    ] = None,
    time: Annotated[
        float | None,
        typer.Option(help="Time of the sweep, in s; by default, when the needle is deepest."),
    ] = None,
    changes: ChangesOption = None,
    seed: SeedOption = None,
) -> None:
    """Acquire one sweep; write it as a picture and as a volume for 3D Slicer."""
    from sonoservo.diagrams.app.scan import scan, summarize_scan, write_scan
    from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
    from sonoservo.diagrams.experiments.registry import load_scenario
    from sonoservo.diagrams.scenario import require_scenario

    changes = list(changes or [])
    if phantom is not None:
        changes.append(f"phantom={phantom}")
    loaded = load_scenario(scenario or "chatelain2013_fig5", changes=changes, seed=seed)
    following = require_scenario(loaded, FollowingScenario)
    say_probe(following.probe)
    result = scan(following, time=time)
    summary = summarize_scan(result, following)
    folder = results.out or free_folder(f"{loaded.name}_seed{loaded.seed}_scan")
    paths = write_scan(result, folder)
    say(result.caption)
    say(
        f"At {summary['time_s']:.2f} s, {summary['inserted_mm']:.1f} mm of the needle are in the "
        f"tissue. Written: {', '.join(map(str, paths))}"
    )
    write_printed(results.json_path, summary)


_COMMANDS = (
    list_command,
    show_command,
    new_command,
    compile_command,
    run_command,
    drive_command,
    scan_command,
    explain_command,
    replay_command,
    compare_command,
    check_command,
    track_command,
    bridge_command,
    locate_command,
    calibrate_command,
    dataset_command,
    reproduce_command,
    benchmark_command,
)
for _command in _COMMANDS:
    app.command(_command.__name__.removesuffix("_command"))(with_common_options(_command))


def run_arguments(arguments: Sequence[str]) -> int:
    """Run the command line, and return the exit code.

    A user's mistake gives one line of text and exit code 2. An error that nothing foresaw is a
    fault of this program: one line that says so, and exit code 70. ``--debug`` adds the traceback.
    """
    try:
        code = app(list(arguments) or ["--help"], standalone_mode=False)
    except (Exception, KeyboardInterrupt) as error:
        if getattr(error, "debug", False):
            traceback.print_exception(error)
        return _report(error)
    return code if isinstance(code, int) else 0


def _with_own_options(line: str, called: str) -> str:
    """Return a message in which an option that the called command lacks names one that has it."""
    called = called.removesuffix("_command")
    if called not in _commands():
        return line

    def named(match: re.Match[str]) -> str:
        others = _commands_with(match[0])
        foreign = called not in others and others and "sonoservo " not in line[: match.start()]
        return f"`sonoservo {others[0]} {match[0]}`" if foreign else match[0]

    return re.sub(r"(?<![\w`-])--[a-z][a-z-]+", named, line)


def _commands() -> Mapping[str, Any]:
    commands: Mapping[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
    return commands


def _commands_with(option: str | None) -> list[str]:
    """Return the names of the commands that have an option."""
    return [
        name
        for name, command in _commands().items()
        if any(option in (*each.opts, *each.secondary_opts) for each in command.params)
    ]


def _usage_line(error: Any) -> str:
    """Return what is wrong with the command line, as the parser says it, and where its help is."""
    line = error.format_message().rstrip(".")
    if (cause := error.__cause__) is not None and hasattr(cause, "errors"):  # lacks the value
        allowed = error.message.partition(", unable")[0]
        line = line.replace(error.message, f"{cause.errors()[0]['input']!r}. {allowed}")
    line += "" if line.endswith("?") else "."
    context = getattr(error, "ctx", None)
    if context is None or context.parent is None:
        return f"{line} `sonoservo --help` lists the commands and their options."
    command = context.command
    option = getattr(error, "option_name", None)
    others = _commands_with(option)
    if option is not None and any("--set" in each.opts for each in command.params):
        line += " A scenario's fields are set by --set, such as --set duration=3."
    elif others and command.name not in others:
        line += f" It is an option of {', '.join(f'`sonoservo {each}`' for each in others)}."
    return f"{line} `sonoservo {command.name} --help` lists the options."


def _report(error: BaseException) -> int:
    """Print an error on one line, and return the exit code."""
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return INTERRUPTED
    if is_interrupted() and not isinstance(error, ConfigurationError | OSError):
        return INTERRUPTED  # a compiled module may turn KeyboardInterrupt into an error of its own
    if isinstance(error, BrokenPipeError):  # as by `sonoservo list | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    code = 2
    if hasattr(error, "format_message"):
        line = _usage_line(error)
    elif isinstance(error, MemoryError):
        line = "there is not enough memory for this"
    elif isinstance(error, OSError) and error.filename and error.strerror:
        line = f"{error.filename}: {error.strerror}"
    elif isinstance(error, ConfigurationError | OSError):
        line = str(error)
    else:
        where = traceback.extract_tb(error.__traceback__)[-1]
        line = (
            f"{describe(error)} ({type(error).__name__} at {Path(where.filename).name}:"
            f"{where.lineno}). This is a fault of sonoservo; repeat the command with --debug and "
            "report the traceback."
        )
        code = 70
    called = getattr(error, "command", "")
    print(f"sonoservo: {shorten(_with_own_options(line, called))}", file=sys.stderr)
    return code
