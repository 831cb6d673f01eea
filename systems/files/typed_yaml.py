"""Typed YAML whose errors say where, what, and what is allowed.

Drake's `yaml_load_typed` does the conversion; the checks before and after it add the path of the
field, the nearest known name, and the dataclasses' own validation.
"""

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from sonoservo.systems.files.renamed import current_name, moved_fields, removed

T = TypeVar("T")


class ConfigurationError(ValueError):
    """A person's mistake in a file or on the command line; its text is all they need to read."""


def suggest(name: str, known: Iterable[str]) -> str:
    """Return the nearest of the known names as a hint, or else all of them."""
    known = sorted(known)
    nearest = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {nearest[0]!r}?" if nearest else f"known: {', '.join(known)}"


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises
    ------
    ConfigurationError
        If the file cannot be read, is not YAML or does not hold a mapping.
    """
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read ({error})") from error
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise ConfigurationError(f"{path}: holds a {type(data).__name__}; a mapping is wanted")
    return data


def load_typed(schema: type[T], data: Mapping[str, Any], source: str) -> T:
    """Make a fully defaulted dataclass from a mapping.

    Where a field may be one of several dataclasses, each with a field ``kind`` whose default is its
    name, ``kind`` chooses, by default that of the field's default; its name alone stands for all
    its defaults.

    Parameters
    ----------
    schema
        The dataclass; nested ones are fine.
    data
        What differs from the defaults.
    source
        Named at the start of every error: a file or a scenario.

    Raises
    ------
    ConfigurationError
        Naming the field by its path, its value and what is allowed.
    """
    from pydrake.common.yaml import yaml_load_typed  # half a second that help need not take

    _check(schema, data, source, "")
    text = yaml.dump(_tagged(schema, dict(data)), Dumper=_Dumper)
    try:
        loaded = yaml_load_typed(schema=schema, data=text, defaults=schema())
    except (RuntimeError, ValueError, TypeError, AssertionError) as error:
        # What pybind11 says of a wrong type ends with the values; signatures help nobody here.
        text = " ".join(str(error).rpartition("Invoked with: ")[2].split())
        raise ConfigurationError(f"{source}: {text}") from error
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
    """Return the fields and their types of a dataclass or of one of Drake's schema classes."""
    if dataclasses.is_dataclass(schema):
        return {field.name: field.type for field in dataclasses.fields(schema)}
    return {field.name: field.type for field in getattr(schema, "__fields__", ())}


def assign(data: dict[str, Any], assignment: str) -> None:
    """Apply ``path.to.field=value`` to a nested mapping, the value read as YAML.

    A name on the way stands for the mapping ``{kind: name}``, see `load_typed`.

    Raises
    ------
    ConfigurationError
        If the text has another form or the path leads through something that is no mapping.
    """
    path, equals, text = assignment.partition("=")
    if not equals or not path:
        raise ConfigurationError(f"{assignment!r}: the form is path.to.field=value")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{assignment!r}: the value is not YAML") from error
    *parents, last = path.split(".")
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


def _index(items: list[Any], key: str, path: str) -> int:
    if not key.isdigit() or int(key) >= len(items):
        raise ConfigurationError(f"{path}: {key!r} must be a number below {len(items)}")
    return int(key)


def _check(schema: Any, value: Any, source: str, path: str, default: Any = None) -> None:
    """Raise ConfigurationError where ``value`` does not fit ``schema``."""

    def fail(wanted: str) -> typing.NoReturn:
        raise ConfigurationError(f"{source}: {path}: {value!r} is not allowed; {wanted} is wanted")

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
            if kind not in kinds:
                hint = suggest(str(kind), kinds)
                raise ConfigurationError(f"{source}: {path}: unknown kind {kind!r}; {hint}")
            _check(kinds[kind], mapping, source, path)
    elif fields := _fields(schema):
        if isinstance(value, _Tagged):
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
    """Return the path of a field of one of Drake's schema classes among these, or None."""
    prefix = f"{path}." if path else ""
    drakes = {name: type_ for name, type_ in fields.items() if hasattr(type_, "__fields__")}
    found = (name for name, type_ in drakes.items() if key in _fields(type_))
    return next((f"{prefix}{name}.{key}" for name in found), None)


def _kinds(schema: Any) -> dict[str, Any]:
    """Dataclasses among which a field's ``kind`` chooses, by name; empty if there is no choice."""
    if typing.get_origin(schema) not in (types.UnionType, typing.Union):
        return {}
    options: list[Any] = [
        each for each in typing.get_args(schema) if dataclasses.is_dataclass(each)
    ]
    return {each().kind: each for each in options} if len(options) > 1 else {}


class _Tagged(dict[str, Any]):
    """A mapping of the dataclass that its ``tag`` names."""

    tag = ""


class _Dumper(yaml.SafeDumper):
    pass


class _Loader(yaml.SafeLoader):
    """Keeps the tags of Drake's schemas, such as ``!Rpy``."""


def _construct_tagged(loader: yaml.SafeLoader, tag: str, node: yaml.Node) -> _Tagged:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, f"!{tag} wants a mapping")
    tagged = _Tagged({str(k): v for k, v in loader.construct_mapping(node, deep=True).items()})
    tagged.tag = tag
    return tagged


_Loader.add_multi_constructor("!", _construct_tagged)


_Dumper.add_representer(
    _Tagged, lambda dumper, value: dumper.represent_mapping(f"!{value.tag}", value)
)


def _kind(mapping: Mapping[str, Any], kinds: Mapping[str, Any], default: Any) -> Any:
    """Kind that a mapping chooses: its own, or else that of the field's default."""
    return mapping.get("kind", getattr(default, "kind", next(iter(kinds))))


def _tagged(schema: Any, value: Any, default: Any = None) -> Any:
    """Return checked data with the chosen dataclasses named, as `yaml_load_typed` wants them."""
    kinds = _kinds(schema)
    if kinds and value is not None:
        mapping = {"kind": value} if isinstance(value, str) else value
        chosen = kinds[_kind(mapping, kinds, default)]
        tagged = _Tagged(_tagged(chosen, mapping))
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
    # YAML 1.1 reads 1e-3, which lacks the point, as text; Drake and people read it as a number.
    try:
        return math.isfinite(float(value))
    except (TypeError, ValueError):
        return False


def _validated(value: Any, source: str, path: str) -> Any:
    """Run every dataclass's own validation, innermost first.

    `yaml_load_typed` sets fields after construction, so ``__post_init__`` has not seen them yet.
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
