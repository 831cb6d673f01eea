"""Requirements on values, as checks and as annotations of a dataclass's fields.

A failed one is a ValueError that names the field, its value and what is allowed.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from numbers import Real
from typing import Annotated, Any, TypeAlias, TypeVar, cast, get_args, get_origin, get_type_hints

T = TypeVar("T")

MAX_TIME = 1e6
"""Longest time that a scenario may set, in s: eleven days."""


def require(condition: bool, name: str, value: object, allowed: str) -> None:
    """Raise ValueError naming the field, its value and what is allowed, unless ``condition``."""
    if not condition:
        raise ValueError(f"{name}: {value!r} is not allowed; it must be {allowed}")


def _is_finite(value: object) -> bool:
    # Nearly all are floats, and an abstract class is several times as slow to ask.
    return isinstance(value, (float, Real)) and math.isfinite(value)


@dataclass(frozen=True)
class Bound:
    """Allowed values in words and as a predicate, for an ``Annotated``."""

    allowed: str
    fits: Callable[[Any], bool]


def above(low: float) -> Bound:
    """Return the bound of a number above a limit."""
    return Bound(f"a number above {low:g}", lambda value: _is_finite(value) and value > low)


def at_least(low: float, unit: str = "") -> Bound:
    """Return the bound of a number that is not below a limit."""
    return Bound(
        f"a number of at least {low:g}{unit}", lambda value: _is_finite(value) and value >= low
    )


def within(low: float, high: float, unit: str = "") -> Bound:
    """Return the bound of a number between two limits, or equal to one."""
    return Bound(
        f"from {low:.4g} to {high:.4g}{unit}",
        lambda value: _is_finite(value) and low <= value <= high,
    )


def between(low: float, high: float, unit: str = "") -> Bound:
    """Return the bound of a number between two limits, and equal to none."""
    return Bound(
        f"between {low:g} and {high:g}{unit}",
        lambda value: _is_finite(value) and low < value < high,
    )


def one_of(*words: str) -> Bound:
    """Return the bound of a word from a list."""
    return Bound(" or ".join(map(repr, words)), lambda value: value in words)


def count_of(count: int, what: str = "numbers") -> Bound:
    """Return the bound of a list with a number of elements."""
    numerals = {2: "two", 3: "three", 6: "six"}
    return Bound(f"{numerals.get(count, count)} {what}", lambda value: len(value) == count)


def require_positive(**values: float) -> None:
    """Raise ValueError unless every value is a finite number above zero."""
    _require_each(above(0), values)


def require_not_negative(**values: float) -> None:
    """Raise ValueError unless every value is a finite number of at least zero."""
    _require_each(at_least(0), values)


def require_within(name: str, value: float, low: float, high: float) -> None:
    """Raise ValueError unless a number lies between two limits, or is equal to one."""
    _require_each(within(low, high), {name: value})


def _require_each(bound: Bound, values: Mapping[str, object]) -> None:
    for name, value in values.items():
        require(bound.fits(value), name, value, bound.allowed)


Positive: TypeAlias = Annotated[float, above(0)]
"""Number above 0."""

Finite: TypeAlias = Annotated[float, Bound("finite", _is_finite)]
"""Number that is finite."""

NotNegative: TypeAlias = Annotated[float, at_least(0)]
"""Number of at least 0."""

Fraction: TypeAlias = Annotated[float, within(0, 1)]
"""Number from 0 to 1."""

PositiveInt: TypeAlias = Annotated[int, at_least(1)]
"""Whole number of at least 1."""

Time: TypeAlias = Annotated[float, within(0, MAX_TIME, " s")]
"""Time from 0 to `MAX_TIME`, in s."""

PositiveTime: TypeAlias = Annotated[
    float,
    Bound(
        f"above 0 and at most {MAX_TIME:g} s",
        lambda value: _is_finite(value) and 0 < value <= MAX_TIME,
    ),
]
"""Time above 0 and up to `MAX_TIME`, in s."""

Point: TypeAlias = Annotated[list[float], count_of(3, "coordinates in m")]
"""Three coordinates, in m."""


def check_bounds(value: Any) -> None:
    """Raise ValueError unless each field of a dataclass is within the bounds of its annotation."""
    schema: Any = type(value)
    for name, bound, of_elements, optional in annotations_of(schema, Bound):
        held = getattr(value, name)
        if held is None and optional:
            continue
        if not of_elements:
            require(bound.fits(held), name, held, bound.allowed)
            continue
        for number, each in enumerate(held):
            require(bound.fits(each), f"{name}.{number}", each, bound.allowed)


class Bounded:
    """Base of dataclasses whose bounds are checked after construction.

    A dataclass with rules of its own calls ``check_bounds(self)`` and then checks them.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        check_bounds(self)


@cache
def annotations_of(schema: type, kind: type[T]) -> list[tuple[str, T, bool, bool]]:
    """Return the annotations of one kind in the types of a dataclass's fields."""
    hints = get_type_hints(schema, include_extras=True)
    return [
        (each.name, *found, _may_be_none(hints[each.name]))
        for each in fields(cast(Any, schema))
        for found in _found(hints[each.name], kind)
    ]


def _may_be_none(hint: Any) -> bool:
    return type(None) in get_args(hint.__origin__ if get_origin(hint) is Annotated else hint)


def _found(hint: Any, kind: type[T], of_elements: bool = False) -> list[tuple[T, bool]]:
    if get_origin(hint) is Annotated:
        own = [(each, of_elements) for each in hint.__metadata__ if isinstance(each, kind)]
        return own + _found(hint.__origin__, kind, of_elements)
    inner = of_elements or get_origin(hint) is list
    return [found for each in get_args(hint) for found in _found(each, kind, inner)]
