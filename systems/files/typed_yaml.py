"""Typed YAML with errors that name the field, its value and the allowed values.

Dataclasses are filled here, so that an error names the path of the field and the nearest known
name; Drake's own schema classes inside them are filled by Drake's `yaml_load_typed`.
"""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Container, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import yaml

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import to_plain
from sonoservo.systems.files.yaml_loader import MAX_DEPTH, MAX_LENGTH, Dumper, Tagged, load_yaml

T = TypeVar("T")

# Largest number of bytes that are read of a file: a character has up to four.
_MAX_BYTES = 4 * MAX_LENGTH


def suggest(name: str, known: Iterable[str]) -> str:
    """Return the known name that contains a name or is nearest to it as a hint, or all names."""
    known = sorted(known)
    meant = nearest(name, known)
    return f"did you mean {meant!r}?" if meant else f"known: {', '.join(known)}"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the only known name that contains a name, or else the one nearest to it, if any."""
    known = sorted(known)
    containing = [each for each in known if len(name) > 2 and name in each]
    near = containing if len(containing) == 1 else difflib.get_close_matches(name, known, n=1)
    return near[0] if near else None


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping; ConfigurationError if that fails."""
    with refusing_failures(path, "cannot be read"), path.open("rb") as file:
        text = file.read(_MAX_BYTES).decode()
    with refusing_failures(path, "not YAML"):
        data = load_yaml(text)
    if data is None:
        raise ConfigurationError(f"{path}: it is empty")
    if not isinstance(data, dict):
        kind = type(data).__name__
        raise ConfigurationError(f"{path}: contains a value of type {kind}; expected a mapping")
    return data


def load_typed(schema: type[T], data: Mapping[str, Any], source: str) -> T:
    """Make a fully defaulted dataclass, perhaps with others in it, from values by field.

    A field may be one of several dataclasses, each with a field ``kind`` whose default is its name.
    The mapping's ``kind``, or the name alone in place of a mapping, chooses one, by default that of
    the field's default. A ConfigurationError names the source, the field by its path, its value and
    what is allowed.
    """
    with refusing_failures(source):
        made: T = _Loader(source).fill(schema, data, "")
        return made


def dump_typed(value: Any) -> str:
    """Return all fields of a dataclass as YAML that `load_typed` reads."""
    return yaml.dump(_plain(value), Dumper=Dumper, sort_keys=False)


def _plain(value: Any) -> Any:
    """Return a value as YAML's own types."""
    schema: Any = type(value)
    if fields := _fields(schema):
        return {name: _plain(getattr(value, name)) for name in fields}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list) else value


@cache
def _fields(schema: Any) -> dict[str, Any]:
    """Return the fields of a dataclass or of one of Drake's schema classes, and their types."""
    if dataclasses.is_dataclass(schema):
        hints = typing.get_type_hints(schema)
        return {field.name: hints[field.name] for field in dataclasses.fields(schema)}
    return {field.name: field.type for field in getattr(schema, "__fields__", ())}


def apply_changes(data: dict[str, Any], changes: Mapping[str, Any] | Sequence[str] | None) -> None:
    """Change fields of a nested mapping: values by dotted path, or ``path.to.field=value``."""
    if isinstance(changes, Mapping):
        for path, value in changes.items():
            _assign(data, str(path), to_plain(value, for_json=False))
        return
    if changes is None:
        return
    if isinstance(changes, str) or not isinstance(changes, Sequence):
        raise ConfigurationError(
            f"changes: {changes!r} is of type {type(changes).__name__}; expected a mapping such as "
            "{'imaging.gain': 0.5} or a list such as ['imaging.gain=0.5']"
        )
    for change in changes:
        path, equals, text = str(change).partition("=")
        if not equals or not path:
            raise ConfigurationError(f"{change!r}: expected the form path.to.field=value")
        with refusing_failures(path, f"{text[:40]!r} is not YAML"):
            value = load_yaml(text)
        _assign(data, path, value)


def _assign(data: dict[str, Any], path: str, value: Any) -> None:
    """Set the value at a dotted path in a nested mapping."""
    *parents, last = path.split(".")
    if len(parents) >= MAX_DEPTH:
        raise ConfigurationError(f"{path}: a field is nested at most {MAX_DEPTH} deep")
    node: Any = data
    for key in parents:
        if isinstance(node, dict) and isinstance(node.get(key), str):
            node[key] = {"kind": node[key]}
        node = node[_index(node, key, path)] if isinstance(node, list) else node.setdefault(key, {})
        if not isinstance(node, (dict, list)):
            raise ConfigurationError(f"{path}: {key!r} is a value; it has no fields")
    if isinstance(node, list):
        node[_index(node, last, path)] = value
    else:
        node[last] = value


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return two nested mappings as one, in which the fields of ``above`` hide those below."""
    result = {**below, **above}
    for key in below.keys() & above.keys():
        if isinstance(below[key], Mapping) and isinstance(above[key], Mapping):
            result[key] = merged(below[key], above[key])
    return result


def _index(items: list[Any], key: str, path: str) -> int:
    if not key.isdecimal() or len(key) > 9 or int(key) >= len(items):
        raise ConfigurationError(f"{path}: {key!r} must be a number below {len(items)}")
    return int(key)


class _Loader:
    """Makes a dataclass of a mapping; ``source`` stands at the start of every error."""

    def __init__(self, source: str) -> None:
        self._source = source

    def _fail(self, path: str, text: str) -> typing.NoReturn:
        raise ConfigurationError(f"{self._source}: {path}: {text}")

    def _refuse(self, path: str, value: Any, wanted: str) -> typing.NoReturn:
        said = "it has no value" if value is None else f"{value!r} is not allowed"
        self._fail(path, f"{said}; expected {wanted}")

    def make(self, hint: Any, value: Any, path: str, default: Any = None) -> Any:
        """Return a value of a field's type, or refuse it; a mapping changes the default."""
        hint = _plain_type(hint)
        origin, options = typing.get_origin(hint), typing.get_args(hint)
        if origin in (types.UnionType, typing.Union):
            return self._choose(hint, value, path, default)
        if dataclasses.is_dataclass(hint) or hasattr(hint, "__fields__"):
            return self.fill(hint, value, path, default)
        # Arrays of Drake's classes are told by their name, as NumPy is not to be loaded here.
        if origin is list or getattr(hint, "__name__", "") == "ndarray":
            if not isinstance(value, list):
                self._refuse(path, value, "a list")
            each = options[0] if options else float
            return [self.make(each, item, f"{path}.{k}") for k, item in enumerate(value)]
        if origin is dict:
            if not isinstance(value, Mapping):
                self._refuse(path, value, "a mapping")
            return {
                self.make(options[0], key, f"{path}: key"): self.make(
                    options[1], item, f"{path}.{key}"
                )
                for key, item in value.items()
            }
        if hint is float:
            if isinstance(value, bool) or not _is_number(value):
                self._refuse(path, value, "a finite number")
            return float(value)
        for kind, wanted in ((bool, "true or false"), (int, "a whole number"), (str, "text")):
            fits = isinstance(value, kind) and (kind is not int or not isinstance(value, bool))
            if hint is kind and not fits:
                self._refuse(path, value, wanted)
        return value

    def _choose(self, hint: Any, value: Any, path: str, default: Any) -> Any:
        """Return a value of one of several types; among dataclasses, its ``kind`` chooses."""
        options = [each for each in typing.get_args(hint) if each is not type(None)]
        if value is None and len(options) < len(typing.get_args(hint)):
            return None
        if len(options) == 1:
            return self.make(options[0], value, path, default)
        found: list[Any] = [each for each in options if dataclasses.is_dataclass(each)]
        kinds = {each().kind: each for each in found}
        if not kinds and value is None:
            self._refuse(path, value, "one")
        if not kinds:
            return value  # one of Drake's own choices, which Drake checks
        mapping = {"kind": value} if isinstance(value, str) else value
        if not isinstance(mapping, Mapping):
            self._refuse(path, value, f"one of {', '.join(kinds)}, or a mapping")
        kind = mapping.get("kind", getattr(default, "kind", next(iter(kinds))))
        if not isinstance(kind, str) or kind not in kinds:
            self._fail(path, f"unknown kind {kind!r}; {suggest(str(kind), kinds)}")
        chosen = kinds[kind]
        return self.fill(chosen, mapping, path, default if type(default) is chosen else None)

    def fill(self, schema: Any, value: Any, path: str, default: Any = None) -> Any:
        """Return a dataclass, or one of Drake's schema classes, with the fields of a mapping."""
        if isinstance(value, Tagged):
            return value
        fields, prefix = _fields(schema), f"{path}." if path else ""
        if not isinstance(value, Mapping):
            self._refuse(path, value, f"a mapping with the fields {', '.join(sorted(fields))}")
        default = schema() if default is None else default
        made = {}
        for key, item in value.items():
            if key not in fields:
                used = {n for n in fields if n in value or getattr(default, n) is not None}
                hint = _hint(str(key), prefix, fields, used)
                self._fail(f"{prefix}{key}", f"unknown field; {hint}")
            made[key] = self.make(fields[key], item, f"{prefix}{key}", getattr(default, key))
        if not dataclasses.is_dataclass(schema):
            from pydrake.common.yaml import yaml_load_typed  # late, as it takes half a second

            text = yaml.dump(dict(value), Dumper=Dumper)
            return yaml_load_typed(schema=schema, data=text, defaults=default)
        try:
            return dataclasses.replace(default, **made)
        except ConfigurationError:
            raise
        except ValueError as error:
            raise ConfigurationError(f"{self._source}: {prefix}{error}") from error


def _plain_type(hint: Any) -> Any:
    return hint.__origin__ if typing.get_origin(hint) is typing.Annotated else hint


def _hint(key: str, prefix: str, fields: Mapping[str, Any], used: Container[str]) -> str:
    """Hint at a field by its exact name in a section, by a near one here, or else in a section."""
    inside = _inside(fields, used)
    meant = key if key in inside else None if nearest(key, fields) else nearest(key, inside)
    return f"did you mean {prefix + inside[meant]!r}?" if meant else suggest(key, fields)


def _inside(fields: Mapping[str, Any], used: Container[str]) -> dict[str, str]:
    """Return the paths of the fields in sections by their names, those in used sections first."""
    paths: dict[str, str] = {}
    for name, hint in sorted(fields.items(), key=lambda field: field[0] not in used):
        union = typing.get_origin(hint) in (types.UnionType, typing.Union)
        for each in typing.get_args(hint) if union else [hint]:
            elements = typing.get_args(each) if typing.get_origin(each) is list else ()
            for key in (key for one in elements or [each] for key in _fields(one)):
                paths.setdefault(key, f"{name}.0.{key}" if elements else f"{name}.{key}")
    return paths


def _is_number(value: Any) -> bool:
    # YAML 1.1 reads 1e-3, which has no point, as text. Drake and people read it as a number.
    try:
        return math.isfinite(float(value))
    except (TypeError, ValueError, OverflowError):
        return False
