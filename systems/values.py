"""What travels on the wires between systems, and how it enters a system."""

import math
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydrake.systems.framework import Context, System

T = TypeVar("T")


class Immutable:
    """A value that deep-copies to itself.

    Drake copies abstract values freely (contexts, unrestricted updates). A frozen dataclass whose
    arrays are read-only needs no copy, so a volume of many megabytes travels at no cost.
    """

    __slots__ = ()

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self


@dataclass(frozen=True, slots=True)
class NotFound(Immutable):
    """A falsy value that says why there is none.

    Parameters
    ----------
    reason
        A short sentence a person can act on.
    """

    reason: str

    def __bool__(self) -> bool:
        return False


def read_only(
    array: ArrayLike, name: str, shape: tuple[int | None, ...], dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """Return a read-only view of ``array``, checked.

    Parameters
    ----------
    array
        Anything NumPy can read; it is not copied when it already has the right type.
    name
        What it is called in the error message.
    shape
        Wanted shape; None allows any extent.
    dtype
        Wanted type of the elements.

    Raises
    ------
    ValueError
        If the shape differs or a floating-point element is not finite.
    """
    view = np.asarray(array, dtype=dtype).view()
    if view.shape != shape and (
        view.ndim != len(shape)
        or any(want not in (None, got) for got, want in zip(view.shape, shape, strict=True))
    ):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ValueError(f"{name} has shape {view.shape}; ({wanted}) is wanted")
    if view.dtype.kind == "f" and not np.isfinite(view).all():
        raise ValueError(f"{name} holds values that are not finite")
    view.flags.writeable = False
    return view


def require(condition: bool, name: str, value: object, allowed: str) -> None:
    """Raise ValueError naming the field, its value and what is allowed, unless ``condition``."""
    if not condition:
        raise ValueError(f"{name}: {value!r} is not allowed; it must be {allowed}")


def require_positive(**values: float) -> None:
    """Raise ValueError unless every value is a finite number above zero."""
    for name, value in values.items():
        require(_is_finite(value) and value > 0, name, value, "a number above 0")


def require_not_negative(**values: float) -> None:
    """Raise ValueError unless every value is a finite number of at least zero."""
    for name, value in values.items():
        require(_is_finite(value) and value >= 0, name, value, "a number of at least 0")


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)


def evaluate(
    system: System, context: Context, port: str, expected: type[T] | tuple[type[T], ...]
) -> T:
    """Evaluate an abstract input port, and check the type of what comes in.

    ``Value[object]`` ports are untyped, so a wrong connection passes ``Connect`` silently; it is
    caught here instead.

    Raises
    ------
    TypeError
        If the value is of another type.
    """
    value = system.GetInputPort(port).Eval(context)
    if not isinstance(value, expected):
        names = expected if isinstance(expected, tuple) else (expected,)
        wanted = " or ".join(each.__name__ for each in names)
        raise TypeError(
            f"port {port!r} of {system.get_name()!r} received a {type(value).__name__}; "
            f"{wanted} is wanted"
        )
    return value
