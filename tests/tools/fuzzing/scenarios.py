"""Fuzzer of scenarios: changes of fields, and damaged YAML."""

import math
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from random import Random
from typing import Any

import yaml

from fuzzing.engine import Outcome, judge
from fuzzing.mutations import NUMBERS, mutate
from sonoservo.diagrams import list_scenarios, load_scenario, make_experiment
from sonoservo.diagrams.app.kept_runs.kept_run import refusing
from sonoservo.diagrams.experiments.registry import present

_YAML = [
    *NUMBERS, "true", "null", "~", "yes", "[]", "{}", "[1]", "[1, 2, 3]", "[.nan, .inf, 1]", "abc",
    "''", "2001-13-45", "2001-12-14", "12:30:45", "!!int x", "!!float y", "!!binary 00", "!Foo {}",
    "!Rpy {deg: [1, 2, 3]}", "!!python/object:os.system {}", "!!set {a, b}", "{kind: []}", "0b101",
    "{a: 1}", "[[[[]]]]", "[" * 400, "{a: " * 60, "&a [*a]", "*a", "? [1]", "- a", "a: b: c", "é",
    "&a [&b [&c [1, 2], *c, *c], *b, *b]", "\0", "/dev/zero", "/etc", "../x.yaml", "agar", "liver",
    ".inf", "-.inf", ".nan", "1e-3", "0.1", "3.0", "10", "100", "1000", "[0.1]", "chatelain2013",
]  # fmt: skip


@cache
def built_in_scenarios() -> dict[str, tuple[str, list[tuple[str, Any]]]]:
    """Return the text of the built-in scenarios, and the paths and values of their fields."""
    found = {}
    for name, path in list_scenarios().items():
        data = yaml.unsafe_load(load_scenario(name).to_yaml().replace("!", "#"))
        found[name] = path.read_text(), list(_leaves("", data))
    return found


def _leaves(path: str, value: Any) -> list[tuple[str, Any]]:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    leaves: list[tuple[str, Any]] = [(path, value)] if path else []
    for key, item in items:
        where = f"{path}.{key}" if path else str(key)
        is_branch = isinstance(item, dict | list) and item
        leaves += _leaves(where, item) if is_branch else [(where, item)]
    return leaves


def bomb(rng: Random) -> str:
    """A document whose aliases multiply."""
    lines = ["a: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    for level in range(rng.choice([3, 9])):
        lines.append(f"b{level}: &a{level + 1} [{', '.join([f'*a{level}'] * 9)}]")
    return "\n".join(lines) + "\n"


def _new_value(value: Any, rng: Random) -> str:
    """Return YAML that may be in the place of a value: nasty, or of its own kind and extreme."""
    if rng.random() < 0.5 or isinstance(value, bool | str | None):
        return rng.choice(_YAML)
    factors = [-1.0, 0.0, 1e-6, 0.01, 0.3, 0.9, 1.1, 3.0, 10.0, 100.0, 1e3, 1e6, 1e12]
    if isinstance(value, int | float):
        new = rng.choice(factors) * (value or 1)
        return str(round(new)) if isinstance(value, int) and math.isfinite(new) else repr(new)
    if isinstance(value, list) and all(isinstance(each, int | float) for each in value):
        return str([rng.choice(factors) * each if rng.random() < 0.5 else each for each in value])
    return rng.choice(_YAML)


def draw(rng: Random, folder: Path, files: bool = True) -> tuple[str, list[str]]:
    """Return the name or file of a scenario, and changes of it."""
    name = rng.choice(sorted(built_in_scenarios()))
    text, leaves = built_in_scenarios()[name]
    if files and rng.random() < 0.35:
        damaged = mutate(text.encode(), 0, rng)[0] if rng.random() < 0.95 else None
        path = folder / "scenario.yaml"
        path.write_bytes(damaged if damaged is not None else (bomb(rng) + text).encode())
        return str(path), []
    changes = []
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        path, value = rng.choice(leaves)
        if rng.random() < 0.05:
            path = rng.choice([path + ".x", path + ".0", path.replace(".", ".."), "a." * 300, ""])
        changes.append(f"{path}={_new_value(value, rng)}")
    return name, changes


def scenario_case(number: int, folder: Path, seed: int = 0) -> Outcome:
    """Load a damaged scenario; every tenth is also built."""
    rng = Random(f"scenarios {seed} {number}")
    name, changes = draw(rng, folder)

    def case() -> float:
        scenario = load_scenario(name, changes=changes)
        assert scenario.seed >= 0
        path = folder / "saved.yaml"
        path.write_text(scenario.to_yaml())
        assert load_scenario(path) == scenario
        if number % 10 == 0:
            with refusing(scenario):
                make_experiment(scenario).close()
        return 0.0

    return judge(f"{name} {[each[:200] for each in changes]}", case)


def compile_for_runs() -> None:
    """Compile what the hardest scenario needs, which takes longer than a case may, in a fork."""
    child = get_context("fork").Process(target=_run_briefly)
    child.start()
    child.join()


def _run_briefly() -> None:
    make_experiment(load_scenario("clinic", changes=["duration=0.4"])).run()


def run_case(number: int, folder: Path, seed: int = 0) -> Outcome:
    """Simulate a second of a damaged scenario that can be built; every tenth is also plotted."""
    rng = Random(f"runs {seed} {number}")

    def case() -> float:
        scenario = load_scenario(name, changes=[*changes, "duration=1.0"])
        with refusing(scenario):
            experiment = make_experiment(scenario)
        try:
            experiment.run()
            log = experiment.log()
            figures = experiment.summarize(log)
            if number % 10 == 0:
                present(experiment).plots(log)
        finally:
            experiment.close()
        assert figures
        return 0.0

    while True:
        name, changes = draw(rng, folder, files=False)
        outcome = judge(f"{name} {changes}", case)
        if outcome.result != "refused":
            return outcome
