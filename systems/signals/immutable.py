"""Values that travel on the wires between systems without being copied."""

from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

Array = TypeVar("Array", bound=NDArray[Any])


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


def seal(array: Array) -> Array:
    """Make an array read-only that was just created, and return it.

    A value keeps a sealed array as it is, where it would copy one that somebody can still write
    to. Whoever creates a large array for a value seals it first, and keeps no other view of it.
    """
    array.flags.writeable = False
    return array


def own(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view that nobody can write to: of a sealed array, or else of a copy.

    Read-only flags are all that tells: a view taken before the array was sealed is not seen.
    """
    owner: Any = array
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:
        owner = owner.base
    if owner is not None and not isinstance(owner, bytes):
        array = seal(array.copy(order="K"))
    return array.view()


def read_only(
    array: ArrayLike, name: str, shape: tuple[int | None, ...], dtype: DTypeLike = np.float64
) -> NDArray[Any]:
    """Return an array, checked, that nobody can write to.

    Parameters
    ----------
    array
        Anything NumPy can read. It is copied unless it is sealed (`seal`) and of the right type, so
        that what its caller does with it later cannot change the value that keeps it.
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
    values = own(np.asarray(array, dtype=dtype))
    if values.shape != shape and (
        values.ndim != len(shape)
        or any(want not in (None, got) for got, want in zip(values.shape, shape, strict=True))
    ):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ValueError(f"{name} has shape {values.shape}; ({wanted}) is wanted")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise ValueError(f"{name} holds values that are not finite")
    return values
