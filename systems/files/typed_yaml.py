"""Typed YAML with errors that name the field, its value and the allowed values.

Drake's `yaml_load_typed` does the conversion. The checks before and after it add the path of the
field, the nearest known name, and the dataclasses' own validation.
"""

import dataclasses
import difflib
import math
import sys
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.renamed import current_name, moved_fields, removed
from sonoservo.systems.files.yaml_loader import MAX_DEPTH, MAX_LENGTH, Dumper, Tagged, load_yaml

T = TypeVar("T")

_MAX_BYTES = 4 * MAX_LENGTH
"""Largest number of bytes that are read of a file: a character has up to four."""


def suggest(name: str, known: Iterable[str]) -> str:
    """Return the known name that contains a name or is nearest to it as a hint, or all names."""
    known = sorted(known)
    containing = [each for each in known if len(name) > 2 and name in each]
    nearest = containing if len(containing) == 1 else difflib.get_close_matches(name, known, n=1)
    return f"did you mean {nearest[0]!r}?" if nearest else f"known: {', '.join(known)}"


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that contains a mapping.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, is not YAML or does not contain a mapping.
    """
    with refusing_failures(path, "cannot be read"), path.open("rb") as file:
        text = file.read(_MAX_BYTES).decode()
    with refusing_failures(path, "not YAML"):
        data = load_yaml(text)
    if not isinstance(data, dict):
        kind = type(data).__name__
        raise ConfigurationError(f"{path}: contains a value of type {kind}; expected a mapping")
    return data


def load_typed(schema: type[T], data: Mapping[str, Any], source: str) -> T:
    """Make a fully defaulted dataclass from a mapping.

    A field may be one of several dataclasses, each with a field ``kind`` whose default is its name.
    The mapping's ``kind`` then chooses the dataclass. Without it, the dataclass is that of the
    field's default. The name alone, in place of a mapping, chooses a dataclass with all its
    defaults.

    Parameters
    ----------
    schema
        Class of the dataclass, which may contain others.
    data
        Values that differ from the defaults.
    source
        File or scenario, named at the start of every error.

    Raises
    ------
    ConfigurationError
        If a field is unknown or its value is not allowed. The message names the field by its path,
        its value and the allowed values.
    """
    from pydrake.common.yaml import yaml_load_typed  # imported late, as it takes half a second

    with refusing_failures(source):
        _check(schema, data, source, "")
        text = yaml.dump(_tagged(schema, dict(data)), Dumper=Dumper)
        loaded = yaml_load_typed(schema=schema, data=text, defaults=schema())
        return _validated(loaded, source, "")


def dump_typed(value: Any) -> str:
    """Return all fields of a dataclass as YAML that `load_typed` reads.

    Fields may hold Drake's schema classes, such as `MultibodyPlantConfig`.
    """
    return yaml.safe_dump(_plain(value), sort_keys=False)


def _plain(value: Any) -> Any:
    """Return a value as YAML's own types."""
    if fields := _fields(type(value)):
        return {name: _plain(getattr(value, name)) for name in fields}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list) else value


def _fields(schema: Any) -> dict[str, Any]:
    """Return the fields of a dataclass or of one of Drake's schema classes, and their types."""
    if dataclasses.is_dataclass(schema):
        return {field.name: field.type for field in dataclasses.fields(schema)}
    return {field.name: field.type for field in getattr(schema, "__fields__", ())}


def without_numpy(value: Any) -> Any:
    """Return a value with NumPy's numbers and arrays, also in mappings and lists, as Python's."""
    # Values of NumPy are there only if somebody has loaded it.
    np = sys.modules.get("numpy")
    if np is not None and isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: without_numpy(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_numpy(item) for item in value]
    return value


def apply_changes(data: dict[str, Any], changes: Mapping[str, Any] | Sequence[str] | None) -> None:
    """Change fields of a nested mapping, in the given order.

    Parameters
    ----------
    data
        Mapping to change.
    changes
        Mapping of dotted paths to values, or texts ``path.to.field=value`` with the value in YAML.

    Raises
    ------
    ConfigurationError
        If they have another form, or a path leads through a value without fields.
    """
    if isinstance(changes, Mapping):
        for path, value in changes.items():
            _assign(data, str(path), without_numpy(value))
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
    """Set the value at a dotted path in a nested mapping.

    A name on the path is equivalent to the mapping ``{kind: name}``; see `load_typed`.
    """
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


def _check(schema: Any, value: Any, source: str, path: str, default: Any = None) -> None:
    """Raise ConfigurationError if ``value`` does not match ``schema``."""

    def fail(wanted: str) -> typing.NoReturn:
        raise ConfigurationError(f"{source}: {path}: {value!r} is not allowed; expected {wanted}")

    if typing.get_origin(schema) in (types.UnionType, typing.Union):
        options = [each for each in typing.get_args(schema) if each is not type(None)]
        if value is None:
            if len(options) == len(typing.get_args(schema)):
                fail("a value")
        elif len(options) == 1:
            _check(options[0], value, source, path)
        else:
            kinds = _kinds(schema)
            if not kinds:
                return  # one of Drake's own choices, which `yaml_load_typed` checks
            mapping = {"kind": value} if isinstance(value, str) else value
            if not isinstance(mapping, Mapping):
                fail(f"one of {', '.join(kinds)}, or a mapping")
            kind = _kind(mapping, kinds, default)
            if not isinstance(kind, str) or kind not in kinds:
                hint = suggest(str(kind), kinds)
                raise ConfigurationError(f"{source}: {path}: unknown kind {kind!r}; {hint}")
            _check(kinds[kind], mapping, source, path)
    elif fields := _fields(schema):
        if isinstance(value, Tagged):
            return
        if not isinstance(value, Mapping):
            fail("a mapping")
        defaults: Any = typing.cast(Any, schema)()
        for key, item in value.items():
            where = f"{path}.{key}" if path else str(key)
            if key not in fields:
                if moved := moved_fields(where, item):
                    old, new = next(iter(moved.items()))
                    raise ConfigurationError(f"{source}: {old}: is now {new!r}")
                now = current_name(str(key), fields) or _path_to(str(key), fields, path)
                if now:
                    raise ConfigurationError(f"{source}: {where}: is now called {now!r}")
                if instead := removed(str(key)):
                    raise ConfigurationError(f"{source}: {where}: {instead}")
                raise ConfigurationError(
                    f"{source}: {where}: unknown field; {suggest(str(key), fields)}"
                )
            _check(fields[key], item, source, where, getattr(defaults, key))
    elif typing.get_origin(schema) is list:
        if not isinstance(value, list):
            fail("a list")
        for index, item in enumerate(value):
            _check(typing.get_args(schema)[0], item, source, f"{path}.{index}")
    elif typing.get_origin(schema) is dict:
        if not isinstance(value, Mapping):
            fail("a mapping")
        for key, item in value.items():
            _check(typing.get_args(schema)[0], key, source, f"{path}: key")
            _check(typing.get_args(schema)[1], item, source, f"{path}.{key}")
    elif schema is float:
        if isinstance(value, bool) or not _is_number(value):
            fail("a finite number")
    elif schema is int:
        if isinstance(value, bool) or not isinstance(value, int):
            fail("a whole number")
    elif schema is bool:
        if not isinstance(value, bool):
            fail("true or false")
    elif schema is str and not isinstance(value, str):
        fail("text")


def _path_to(key: str, fields: Mapping[str, Any], path: str) -> str | None:
    """Return the path of a field of one of Drake's schema classes in ``fields``, or None."""
    prefix = f"{path}." if path else ""
    drakes = {name: type_ for name, type_ in fields.items() if hasattr(type_, "__fields__")}
    found = (name for name, type_ in drakes.items() if key in _fields(type_))
    return next((f"{prefix}{name}.{key}" for name in found), None)


def _kinds(schema: Any) -> dict[str, Any]:
    """Return the dataclasses among which ``kind`` chooses, by name; empty if there is no choice."""
    if typing.get_origin(schema) not in (types.UnionType, typing.Union):
        return {}
    options: list[Any] = [
        each for each in typing.get_args(schema) if dataclasses.is_dataclass(each)
    ]
    return {each().kind: each for each in options} if len(options) > 1 else {}


def _kind(mapping: Mapping[str, Any], kinds: Mapping[str, Any], default: Any) -> Any:
    """Return the kind that a mapping chooses, which is that of the field's default if missing."""
    return mapping.get("kind", getattr(default, "kind", next(iter(kinds))))


def _tagged(schema: Any, value: Any, default: Any = None) -> Any:
    """Return checked data with tags for the chosen dataclasses, as `yaml_load_typed` needs them."""
    kinds = _kinds(schema)
    if kinds and value is not None:
        mapping = {"kind": value} if isinstance(value, str) else value
        chosen = kinds[_kind(mapping, kinds, default)]
        tagged = Tagged(_tagged(chosen, mapping))
        tagged.tag = chosen.__name__
        return tagged
    if isinstance(value, Mapping) and dataclasses.is_dataclass(schema):
        fields = {field.name: field.type for field in dataclasses.fields(schema)}
        defaults: Any = typing.cast(Any, schema)()
        return {
            key: _tagged(fields[key], item, getattr(defaults, key)) for key, item in value.items()
        }
    if isinstance(value, list) and typing.get_origin(schema) is list:
        return [_tagged(typing.get_args(schema)[0], item) for item in value]
    return value


def _is_number(value: Any) -> bool:
    # YAML 1.1 reads 1e-3, which has no point, as text. Drake and people read it as a number.
    try:
        return math.isfinite(float(value))
    except (TypeError, ValueError, OverflowError):
        return False


def _validated(value: Any, source: str, path: str) -> Any:
    """Run every dataclass's own validation, innermost first.

    `yaml_load_typed` sets fields after construction, so ``__post_init__`` has not checked them yet.
    """
    if isinstance(value, list):
        return [_validated(item, source, f"{path}.{index}") for index, item in enumerate(value)]
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    prefix = f"{path}." if path else ""
    fields = {
        field.name: _validated(getattr(value, field.name), source, prefix + field.name)
        for field in dataclasses.fields(value)
    }
    try:
        return dataclasses.replace(value, **fields)
    except ConfigurationError:
        raise
    except ValueError as error:
        raise ConfigurationError(f"{source}: {prefix}{error}") from error
