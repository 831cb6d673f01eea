"""Linear interpolation of images at points, with the kernels that all samplers share."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

_SLACK = 1e-9
"""Distance in elements by which rounding may put a point on the grid's edge outside the grid."""

# Without fast-math the order of the sums is fixed, and results repeat bit for bit.


@njit(cache=True, nogil=True, error_model="numpy")
def trilinear(array: Any, x: Any, y: Any, z: Any) -> Any:  # pragma: no cover - compiled
    """Return a 3D array's value at fractional indices from 0 to its last element.

    Compiled loops call this for each point. It does not check bounds.
    """
    nx, ny, nz = array.shape
    i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
    x, y, z = x - i, y - j, z - k
    value = 0.0
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                weight = (x if di else 1 - x) * (y if dj else 1 - y) * (z if dk else 1 - z)
                value += weight * float(array[i + di, j + dj, k + dk])
    return value


@njit(cache=True, nogil=True, error_model="numpy")
def flagged(flags: Any, x: Any, y: Any, z: Any) -> Any:  # pragma: no cover - compiled
    """Return True if an element with a weight in `trilinear` has its flag set."""
    if flags[int(x + 0.5), int(y + 0.5), int(z + 0.5)]:
        return True
    nx, ny, nz = flags.shape
    i, j, k = min(int(x), nx - 2), min(int(y), ny - 2), min(int(z), nz - 2)
    for p in range(i, i + 1 + (x > i)):
        for q in range(j, j + 1 + (y > j)):
            for r in range(k, k + 1 + (z > k)):
                if flags[p, q, r]:
                    return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def bilinear(array: Any, x: Any, y: Any) -> Any:  # pragma: no cover - compiled
    """Return a 2D array's value at fractional indices, as `trilinear` does in 3D."""
    nx, ny = array.shape
    i, j = min(int(x), nx - 2), min(int(y), ny - 2)
    x, y = x - i, y - j
    value = 0.0
    for di in range(2):
        for dj in range(2):
            weight = (x if di else 1 - x) * (y if dj else 1 - y)
            value += weight * float(array[i + di, j + dj])
    return value


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(  # pragma: no cover - compiled
    array: Any, points: Any, origin: Any, spacing: Any, outside: float, nearest: bool, values: Any
) -> None:
    axes = array.ndim
    last = np.array(array.shape) - 1
    at = np.zeros(axes)
    for m in range(points.shape[0]):
        inside, number = True, True
        for axis in range(axes):
            index = (points[m, axis] - origin[axis]) / spacing[axis]
            inside &= -_SLACK <= index <= last[axis] + _SLACK
            number &= index == index
            at[axis] = min(max(index, 0.0), float(last[axis]))
        if not (inside or (nearest and number)):
            values[m] = outside
        elif axes == 3:
            values[m] = trilinear(array, at[0], at[1], at[2])
        else:
            values[m] = bilinear(array, at[0], at[1])


@njit(cache=True, nogil=True, error_model="numpy")
def _sample_flags(  # pragma: no cover - compiled
    flags: Any, points: Any, origin: Any, spacing: Any, values: Any
) -> None:
    last = np.array(flags.shape) - 1
    at = np.zeros(3)
    for m in range(points.shape[0]):
        inside = True
        for axis in range(3):
            index = (points[m, axis] - origin[axis]) / spacing[axis]
            inside &= -_SLACK <= index <= last[axis] + _SLACK
            at[axis] = min(max(index, 0.0), float(last[axis]))
        values[m] = inside and flagged(flags, at[0], at[1], at[2])


def sample_flags(
    flags: NDArray[np.bool_], points: ArrayLike, origin: ArrayLike, spacing: ArrayLike
) -> NDArray[np.bool_]:
    """Return the (...) flags of (..., 3) points that have an element with a set flag around them.

    The grid is that of `sample_grid`; points outside it have none.
    """
    points = np.asarray(points, dtype=float)
    values = np.empty(points.shape[:-1], np.bool_)
    _sample_flags(
        flags,
        points.reshape(-1, 3),
        np.asarray(origin, dtype=float),
        np.asarray(spacing, dtype=float),
        values.reshape(-1),
    )
    return values


def sample_grid(
    array: NDArray[Any],
    points: ArrayLike,
    origin: ArrayLike,
    spacing: ArrayLike,
    outside: float | None,
) -> NDArray[np.float32]:
    """Return (...) values of an image in 2D or 3D at (..., 2) or (..., 3) points.

    Element [i, j, k] lies at ``origin + spacing * (i, j, k)``. Points outside and NaN have the
    value ``outside``; if it is None, those outside have that of the nearest edge, and NaN stays
    NaN.
    """
    points = np.asarray(points, dtype=float)
    values = np.empty(points.shape[:-1], np.float32)
    _sample(
        array,
        points.reshape(-1, array.ndim),
        np.asarray(origin, dtype=float),
        np.asarray(spacing, dtype=float),
        np.nan if outside is None else float(outside),
        outside is None,
        values.reshape(-1),
    )
    return values
