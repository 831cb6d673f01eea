"""Search for the voxels that changed most between two volumes."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import chosen_ties

_ALL = np.ones((1, 1, 1), bool)


@njit(cache=True, nogil=True)
def _changes(  # pragma: no cover - compiled
    a: Any, b: Any, seen_a: Any, seen_b: Any, both: bool
) -> Any:
    """Find the voxels that differ, and by how much."""
    nx, ny, nz = a.shape
    capacity = 65536
    index = np.empty(capacity, np.int64)
    change = np.empty(capacity, np.float32)
    found = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                x, y = float(a[i, j, k]), float(b[i, j, k])
                if x == y or (both and not (seen_a[i, j, k] and seen_b[i, j, k])):
                    continue
                if found == capacity:
                    capacity *= 2
                    index = np.concatenate((index, np.empty_like(index)))
                    change = np.concatenate((change, np.empty_like(change)))
                index[found] = (i * ny + j) * nz + k
                change[found] = abs(x - y)
                found += 1
    return index[:found], change[:found]


def top_differences(
    current: NDArray[Any],
    previous: NDArray[Any],
    count: int,
    *,
    seen: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None,
) -> tuple[NDArray[np.int64], float]:
    """Find the voxels with the largest absolute difference (Chatelain 2013, eq. 1).

    The threshold is the order statistic that leaves ``count`` voxels; of those that equal it, a
    subset scattered over the volume is taken. Only voxels that both volumes show (``seen``) are
    compared. Returns their (m, 3) indices and the smallest difference among them, 0 if nothing
    changed.
    """
    seen_now, seen_before = seen or (_ALL, _ALL)
    index, change = _changes(current, previous, seen_now, seen_before, seen is not None)
    if len(index) == 0:
        return np.empty((0, 3), np.int64), 0.0
    if len(index) > count:
        threshold = np.partition(change, -count)[-count]
        above = index[change > threshold]
        ties = chosen_ties(index[change == threshold], count - len(above))
        index = np.concatenate([above, ties])
    else:
        threshold = change.min()
    return np.stack(np.unravel_index(index, current.shape), axis=1), float(threshold)
