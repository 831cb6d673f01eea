"""Commands about scenarios themselves: list, show and new."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from sonoservo.diagrams.app.options import (
    ChangesOption,
    JsonOption,
    ScenarioArgument,
    console,
    say,
    write_printed,
)
from sonoservo.systems.files.refusals import ConfigurationError


def list_command(json_path: JsonOption = None) -> None:
    """List the built-in scenarios, and the dials that make a scenario harder."""
    from sonoservo.diagrams.dials import load_dials
    from sonoservo.diagrams.experiments.registry import describe_scenarios

    scenarios, dials = describe_scenarios(), load_dials()
    say("Scenarios:")
    for name, description in scenarios.items():
        say(f"sonoservo run {name}\n    {description}")
    say("\nDials that make a scenario harder, here at a moderate strength:")
    for name, dial in dials.items():
        changes = " ".join(f"--set {shlex.quote(each)}" for each in dial.changes())
        say(f"{changes}\n    {name}: {dial.line}")
    write_printed(
        json_path,
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
    console.print(f"Written: {path}. Change it, then: sonoservo run {path}", soft_wrap=True)
