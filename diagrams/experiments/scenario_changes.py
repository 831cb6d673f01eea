"""Differences between scenarios, field by field."""

from collections.abc import Mapping
from typing import Any

import yaml

from sonoservo.diagrams.experiments.registry import list_scenarios, load_scenario
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.evaluation.reports.report import Change
from sonoservo.systems.files.field_meanings import field_meaning

_HEAD = ("experiment", "name", "description", "published_figures")
"""Fields that do not change a run."""


def base_of(scenario: Scenario) -> tuple[Scenario, str]:
    """Return the built-in scenario that was changed, or all defaults, and its name in words.

    Some fields of a scenario are drawn by its seed, so the built-in one has the same.
    """
    name = scenario.name.removesuffix("_as_published")
    if name in list_scenarios():
        built_in = load_scenario(name, seed=scenario.seed)
        if type(built_in) is type(scenario):
            return built_in, f"the built-in scenario {name}"
    return type(scenario)(), f"the defaults of the experiment {scenario.experiment!r}"


def changed_fields(before: Scenario, after: Scenario, *, seed: bool = False) -> list[Change]:
    """Return the fields in which two scenarios of one class differ."""
    one, other = (_flat(yaml.safe_load(each.to_yaml())) for each in (before, after))
    changes = []
    for path in {**one, **other}:
        same = path in one and path in other and one[path] == other[path]
        if same or path.partition(".")[0] in (*_HEAD, *([] if seed else ["seed"])):
            continue
        texts = [_text(each[path]) if path in each else "–" for each in (one, other)]
        meaning = field_meaning(type(after), path)
        changes.append(Change(path=path, meaning=meaning, before=texts[0], after=texts[1]))
    return changes


def _flat(data: Any, path: str = "") -> dict[str, Any]:
    """Return the values of nested mappings and lists of mappings by their dotted paths."""
    if isinstance(data, list) and any(isinstance(each, Mapping) for each in data):
        data = {str(number): each for number, each in enumerate(data)}
    if not isinstance(data, Mapping):
        return {path: data}
    flat: dict[str, Any] = {}
    for key, value in data.items():
        flat |= _flat(value, f"{path}.{key}" if path else str(key))
    return flat


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    if value is None or value == "":
        return "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
