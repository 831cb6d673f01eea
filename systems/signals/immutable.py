"""Base class and helpers for values that travel between systems without being copied."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from math import isfinite
from typing import Annotated, Any, Literal, Self, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.requirements import annotations_of, check_bounds

Array = TypeVar("Array", bound=NDArray[Any])


class Shape:
    """Extents and type of an array, for the annotation of a field.

    None allows any extent. A letter stands for the same extent in all arrays of a value, and "3n"
    for three times that.
    """

    def __init__(self, *extents: int | str | None, dtype: DTypeLike = np.float64) -> None:
        self.dtype = dtype
        self.letters = {
            at: (each[-1], int(each[:-1] or 1))
            for at, each in enumerate(extents)
            if isinstance(each, str)
        }
        self._others = tuple(None if isinstance(each, str) else each for each in extents)

    def given(self, known: Mapping[str, int]) -> tuple[int | None, ...]:
        """Return the extents with numbers in place of the letters that are known, else None."""
        if not self.letters:
            return self._others
        extents = list(self._others)
        for at, (letter, times) in self.letters.items():
            if letter in known:
                extents[at] = times * known[letter]
        return tuple(extents)


Vector3: TypeAlias = Annotated[NDArray[np.float64], Shape(3)]
"""Three numbers, such as a position."""

Matrix3: TypeAlias = Annotated[NDArray[np.float64], Shape(3, 3)]
"""Three times three numbers, such as a covariance."""


class Immutable:
    """Base class of frozen dataclasses whose deep copy is the value itself.

    Drake often copies abstract values (in contexts and unrestricted updates). A value with
    read-only arrays needs no copy, so a volume of many megabytes travels at no cost.

    The bounds (`check_bounds`) and shapes (`Shape`) in the annotations of the fields are checked,
    and the arrays kept as `read_only` ones. A ValueError names the field. A value with further
    rules extends ``__post_init__``.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        check_bounds(self)
        schema: Any = type(self)
        shapes = _shapes(schema)
        known = self._extents() if shapes else {}
        for name, shape, optional in shapes:
            held = getattr(self, name)
            if held is None and optional:
                continue
            array = read_only(held, name, shape.given(known), shape.dtype)
            for at, (letter, times) in shape.letters.items():
                known.setdefault(letter, array.shape[at] // times)
            object.__setattr__(self, name, array)

    def _extents(self) -> dict[str, int]:
        """Return the extents of the value's arrays that follow from other fields, by letter."""
        return {}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # A dataclass makes a representation of its own unless there is one.
        if "__repr__" not in vars(cls):
            cls.__repr__ = _short_repr  # type: ignore[method-assign]

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self


def _short_repr(value: object) -> str:
    """Return a value in one line, with large arrays by their shape and poses by their place."""
    parts = (f"{each.name}={_short(getattr(value, each.name))}" for each in fields(value))  # type: ignore[arg-type]
    return f"{type(value).__name__}({', '.join(parts)})"


def _short(value: object) -> str:
    if isinstance(value, np.ndarray) and value.size > 6:
        return f"<{' x '.join(map(str, value.shape))} {value.dtype}>"
    if isinstance(value, np.ndarray):
        return np.array2string(value, precision=5, separator=", ").replace("\n", "")
    if isinstance(value, RigidTransform):
        return f"<pose at {np.round(value.translation(), 4).tolist()}>"
    return f"{value:.6g}" if isinstance(value, float) else repr(value)


@dataclass(frozen=True, slots=True)
class NotFound(Immutable):
    """Falsy value that takes the place of a missing result and gives the reason."""

    reason: str
    """Short sentence on which a person can act."""

    def __bool__(self) -> bool:
        return False


@cache
def _shapes(schema: type) -> list[tuple[str, Shape, bool]]:
    """Return name and shape of each array among a value's fields, and if it may be None."""
    return [(name, shape, optional) for name, shape, _, optional in annotations_of(schema, Shape)]


def seal(array: Array) -> Array:
    """Make a newly created array read-only, and return it.

    A value keeps a sealed array without a copy. It copies any array that can still be written to.
    Code that creates a large array for a value should seal it first, and keep no other view of it.
    """
    array.flags.writeable = False
    return array


def own(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of a sealed array, or of a copy of any other array."""
    owner: Any = array
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:
        owner = owner.base
    if owner is not None and not isinstance(owner, bytes):
        array = seal(array.copy(order="K"))
    return array.view()


def read_only(
    array: ArrayLike, name: str, shape: tuple[int | None, ...], dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """Return an array as a read-only one of a type and shape, in which None allows any extent.

    It is copied unless it is sealed (`seal`) and of the right type, so that later changes by the
    caller cannot affect the value that keeps it. A ValueError names the array if the shape differs
    or a floating-point element is not finite.
    """
    # Compiled code takes volumes and sweeps in C's order; for another it would be compiled anew.
    order: Literal["K", "C"] = "C" if len(shape) > 2 else "K"
    values = own(np.asarray(array, dtype=dtype, order=order))
    if values.shape != shape and not _fits(values.shape, shape):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ValueError(f"{name} has shape {values.shape}; expected ({wanted})")
    # The sum of squares is fast, and finite unless an element is not or is very large.
    suspect = values.dtype.kind == "f" and not isfinite(np.vdot(values, values))
    if suspect and not np.isfinite(values).all():
        raise ValueError(f"{name} holds values that are not finite")
    return values


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    if len(shape) != len(wanted):
        return False
    for extent, want in zip(shape, wanted, strict=True):  # several times as fast as a generator
        if want is not None and want != extent:
            return False
    return True
