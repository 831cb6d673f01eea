"""Fields of nested dataclasses with their defaults and descriptions, from the docstrings."""

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Iterator
from typing import Any


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


def field_rows(
    schema: type, path: str = "", above: tuple[type, ...] = ()
) -> Iterator[tuple[str, str, str]]:
    """Yield path, default and description of each field, sections before what they contain."""
    hints = typing.get_type_hints(schema)
    inherited: dict[str, str] = {}
    for each in reversed(schema.__mro__):
        inherited |= described_parameters(each)
    for field in dataclasses.fields(schema):
        name = f"{path}{field.name}"
        yield name, _default(field), inherited.get(field.name, "")
        inner_schemas = list(_schemas(hints[field.name]))
        for inner in inner_schemas:
            if inner not in above:
                kind = f"{inner.__name__}: " if len(inner_schemas) > 1 else ""
                for inside, default, text in field_rows(inner, f"{name}.", (*above, inner)):
                    yield inside, default, kind + text


def field_meaning(schema: type, path: str) -> str:
    """Return the first sentence of the description of a field, by its dotted path; may be empty."""
    wanted = re.sub(r"\.\d+", "", path)
    for name, _, text in field_rows(schema):
        if name == wanted:
            sentence = re.split(r"[.;] ", text.rpartition("Parameters: ")[2] + " ", maxsplit=1)[0]
            return sentence.strip().removesuffix(".").replace("`", "")
    return ""


def _schemas(hint: Any) -> Iterator[type]:
    """Yield the dataclasses that a type allows, such as those of a choice by ``kind``."""
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        yield hint
    elif isinstance(hint, types.UnionType) or typing.get_origin(hint) is not None:
        for each in typing.get_args(hint):
            yield from _schemas(each)


def _default(field: "dataclasses.Field[Any]") -> str:
    """Return the default of a field as text; empty if it has none or is a section."""
    value: Any = field.default
    if field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
    if value is dataclasses.MISSING or dataclasses.is_dataclass(value):
        return ""
    return f"`{value!r}`"
