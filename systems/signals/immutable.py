"""Values that travel on the wires between systems without being copied."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


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
