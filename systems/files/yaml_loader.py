"""YAML loader with a budget for the size, the depth and the aliases of a document."""

import math
from collections import Counter
from decimal import Decimal
from typing import Any

import yaml

MAX_LENGTH = 2_000_000
"""Largest length of a document in characters; a scenario has some thousand."""

MAX_DEPTH = 40
"""Largest depth of mappings and lists in one another."""

MAX_NODES = 200_000
"""Largest number of values, with aliases written out."""


class Tagged(dict[str, Any]):
    """Mapping for the dataclass named by its ``tag``."""

    tag = ""


class Dumper(yaml.SafeDumper):
    """YAML dumper that writes the tags of Drake's schemas, such as ``!Rpy``, and 3.3e+6."""


class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """YAML loader that keeps the tags of Drake's schemas, such as ``!Rpy``, and every value."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping; YAMLError if it gives a key twice, of which one would be lost."""
        keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        if twice := [key for key, count in keys.items() if count > 1]:
            line = node.start_mark.line + 1
            raise yaml.YAMLError(f"{twice[0]} is given twice in the mapping from line {line} on")
        return super().construct_mapping(node, deep)


def load_yaml(text: str) -> Any:
    """Return the value of a YAML document that is not larger or deeper than any scenario."""
    if len(text) > MAX_LENGTH:
        raise yaml.YAMLError(
            f"the document has {len(text)} characters; at most {MAX_LENGTH} are allowed"
        )
    _judge(text)
    return yaml.load(text, Loader=Loader)


def _judge(text: str) -> None:
    """Raise YAMLError if a document is too deep, or too large once its aliases are written out."""
    sizes: dict[str, int] = {}
    open_nodes: list[tuple[str | None, int]] = []  # anchor, and number of nodes before it
    count = 0
    for event in yaml.parse(text, Loader=Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((event.anchor, count))
            count += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = open_nodes.pop()
            if anchor:
                sizes[anchor] = count - before
        elif isinstance(event, yaml.ScalarEvent):
            count += 1
            if event.anchor:
                sizes[event.anchor] = 1
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor in {anchor for anchor, _ in open_nodes}:
                raise yaml.YAMLError(f"the alias *{event.anchor} contains itself")
            count += sizes.get(event.anchor or "", 1)
        if len(open_nodes) > MAX_DEPTH:
            raise yaml.YAMLError(f"it is nested deeper than {MAX_DEPTH} levels")
        if count > MAX_NODES:
            raise yaml.YAMLError(f"it has more than {MAX_NODES} values, with its aliases")


def _construct_tagged(loader: Any, tag: str, node: yaml.Node) -> Tagged:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(None, None, f"!{tag} must be followed by a mapping")
    tagged = Tagged({str(k): v for k, v in loader.construct_mapping(node, deep=True).items()})
    tagged.tag = tag
    return tagged


Loader.add_multi_constructor("!", _construct_tagged)
Dumper.add_representer(
    Tagged, lambda dumper, value: dumper.represent_mapping(f"!{value.tag}", value)
)


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.ScalarNode:
    """Write a large number such as a frequency by its exponent; YAML 1.1 wants point and sign."""
    if not 1e5 <= abs(value) < math.inf:
        return dumper.represent_float(value)
    digits, _, exponent = f"{Decimal(repr(value)).normalize():e}".partition("e")
    digits = digits if "." in digits else f"{digits}.0"
    return dumper.represent_scalar("tag:yaml.org,2002:float", f"{digits}e{exponent}")


Dumper.add_representer(float, _represent_float)
