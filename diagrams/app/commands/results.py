"""Commands about scenarios and the kept results of runs."""

import shlex
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from sonoservo.diagrams.app.options import (
    ChangesOption,
    Page,
    Printed,
    Results,
    ScenarioArgument,
    console,
    free_folder,
    say,
    say_report,
    write_printed,
)
from sonoservo.systems.files.refusals import ConfigurationError


def replay_command(
    folder: Annotated[Path, typer.Argument(help="Folder of a run.")],
    page: Page,
    once: Annotated[bool, typer.Option("--once", help="End at the end of the run.")] = False,
) -> None:
    """Replay a kept run in the console: world, slices, strips and state, at any time and speed."""
    from sonoservo.diagrams.app.kept_runs.replay import read_replay
    from sonoservo.diagrams.app.pages.pages import open_pages

    replay = read_replay(folder)
    pages = open_pages(replay.title, page, kept=folder)
    pages.announce(console)
    if not (folder / "replay.html").is_file():
        console.print("There is no replay.html: run with a page or with --replay for the world.")
    console.print("The slider `time` turns the run back and forth; Ctrl-C ends the replay.")
    with suppress(KeyboardInterrupt):
        replay.play(pages.console, once=once)


def compare_command(
    folders: Annotated[list[Path], typer.Argument(help="Folders of two or more runs.")],
    results: Results,
) -> None:
    """Compare kept runs: what was changed between them, figures side by side, curves overlaid."""
    from sonoservo.diagrams.app.kept_runs.compare import compare

    folder = results.out or free_folder("comparison")
    comparison = compare(folders, folder)
    console.print(comparison.table())
    say_report(folder)
    write_printed(results.json_path, comparison.as_json())


def explain_command(
    folder: Annotated[Path, typer.Argument(help="Folder of a run made with --explain.")],
    printed: Printed,
    time: Annotated[
        float | None, typer.Option(help="Draw the kept volume nearest to this time, in s.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Picture, FILE.png; by default in the run's folder.")
    ] = None,
) -> None:
    """Show why an estimate was wrong: what the tracker looked at, beside the truth.

    Without --time the volumes that were kept are listed.
    """
    from sonoservo.diagrams.app.kept_runs.explain import explanation_table, read_explained_run
    from sonoservo.systems.evaluation.explanation.explanation_sheet import describe
    from sonoservo.systems.evaluation.reports.plots import png
    from sonoservo.systems.files.writing import write_atomically

    explained_run = read_explained_run(folder)
    if time is None:
        rows = explained_run.rows()
        console.print(explanation_table(rows))
        say(f"Draw one of them: sonoservo explain {shlex.quote(str(folder))} --time T")
        write_printed(printed.json_path, rows)
        return
    explained = explained_run.nearest(time)
    asked, shown = (f"{float(each):.2f} s" for each in (time, explained.volume_time))
    path = out or folder / f"explanation_{float(explained.volume_time):.2f}s.png"
    write_atomically(path, png(explained_run.sheet(explained)))
    if asked != shown:
        say(f"Nothing was kept at {asked}; this is {shown}, the nearest kept volume.")
    say(describe(explained, explained_run.tip_error(explained)))
    say(f"Drawn: {path}")
    write_printed(printed.json_path, explained_run.row(explained))


def list_command(printed: Printed) -> None:
    """List the built-in scenarios, and the dials that make a scenario harder."""
    from sonoservo.diagrams.dials import load_dials
    from sonoservo.diagrams.experiments.registry import describe_scenarios

    scenarios, dials = describe_scenarios(), load_dials()
    for name, description in scenarios.items():
        say(f"sonoservo run {name}\n    {description}")
    say("\nDials that make a scenario harder, here at a moderate strength:")
    for name, dial in dials.items():
        changes = " \\\n".join(f"--set {shlex.quote(each)}" for each in dial.changes())
        say(f"{changes}  # {name}: {dial.words(1.0).partition(',')[0]}")
    write_printed(
        printed.json_path,
        {
            "scenarios": scenarios,
            "dials": {
                name: {"description": dial.line, "moderate": dict(dial.moderate)}
                for name, dial in dials.items()
            },
        },
    )


def show_command(scenario: ScenarioArgument, changes: ChangesOption = None) -> None:
    """Print a scenario with all its fields, as YAML that `sonoservo run` reads."""
    from sonoservo.diagrams.experiments.registry import load_scenario

    print(load_scenario(scenario, changes=changes).to_yaml(), end="")


def new_command(
    path: Annotated[Path, typer.Argument(help="YAML file to write; it must not exist yet.")],
    scenario: Annotated[
        str, typer.Option("--from", help="Scenario to begin with, from `sonoservo list`.")
    ] = "chatelain2013_fig5",
) -> None:
    """Write a scenario of your own: a copy of a built-in one, with its comments."""
    from sonoservo.diagrams.experiments.registry import list_scenarios, load_scenario
    from sonoservo.systems.files.writing import write_atomically

    if path.suffix not in (".yaml", ".yml"):
        raise ConfigurationError(f"{path} must end in .yaml")
    if path.exists():
        raise ConfigurationError(f"{path} exists already; it is left as it is")
    load_scenario(scenario)
    source = list_scenarios().get(scenario, Path(scenario))
    write_atomically(path, source.read_text(encoding="utf-8"))
    say(f"Written: {path}. Change it, then: sonoservo run {shlex.quote(str(path))}")
