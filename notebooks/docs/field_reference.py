"""Reference of all fields of a scenario, made of the dataclasses and their docstrings."""

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sonoservo.diagrams.experiments.registry import EXPERIMENTS, experiment_class
from sonoservo.systems.files.writing import write_atomically


def described_parameters(schema: type) -> dict[str, str]:
    """Return the descriptions in the section "Parameters" of a class's docstring, by name."""
    lines = (inspect.getdoc(schema) or "").splitlines()
    found: dict[str, str] = {}
    names: list[str] = []
    inside = False
    for line, after in zip(lines, [*lines[1:], ""], strict=True):
        if re.fullmatch("-+", after):
            inside = line == "Parameters"
        elif inside and line and not line[0].isspace() and not re.fullmatch("-+", line):
            names = [name.strip() for name in line.split(",")]
            found |= dict.fromkeys(names, "")
        elif inside and line.strip():
            for name in names:
                found[name] = f"{found[name]} {line.strip()}".strip()
    return found


def schemas(hint: Any) -> Iterator[type]:
    """Yield the dataclasses that a type allows, such as those of a choice by ``kind``."""
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        yield hint
    elif isinstance(hint, types.UnionType) or typing.get_origin(hint) is not None:
        for each in typing.get_args(hint):
            yield from schemas(each)


def default_of(field: "dataclasses.Field[Any]") -> str:
    """Return the default of a field as text; empty if it has none or is a section."""
    value: Any = field.default
    if field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
    if value is dataclasses.MISSING or dataclasses.is_dataclass(value):
        return ""
    return f"`{value!r}`"


def rows(schema: type, path: str = "", above: tuple[type, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield path, default and description of each field, sections before what they contain."""
    hints = typing.get_type_hints(schema)
    inherited: dict[str, str] = {}
    for each in reversed(schema.__mro__):
        inherited |= described_parameters(each)
    for field in dataclasses.fields(schema):
        name = f"{path}{field.name}"
        yield name, default_of(field), inherited.get(field.name, "")
        for inner in schemas(hints[field.name]):
            if inner not in above:
                kind = f"{inner.__name__}: " if len(list(schemas(hints[field.name]))) > 1 else ""
                for inside, default, text in rows(inner, f"{name}.", (*above, inner)):
                    yield inside, default, kind + text


def write_reference(path: Path) -> None:
    """Write the reference of all experiments as a page of Markdown."""
    page = ["# Fields of a scenario", ""]
    for name in EXPERIMENTS:
        page += [f"## experiment: {name}", "", "| field | default | |", "|---|---|---|"]
        for cells in rows(experiment_class(name).scenario_class):
            page.append("| `" + "` | ".join([cells[0], " | ".join(cells[1:])]) + " |")
        page.append("")
    write_atomically(path, "\n".join(page))
