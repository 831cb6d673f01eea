"""The voxels that changed most between two volumes."""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

_BINS = 4096


@njit(cache=True, nogil=True)
def _largest_difference(a: Any, b: Any) -> float:  # pragma: no cover - compiled
    largest = 0.0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            for k in range(a.shape[2]):
                largest = max(largest, abs(float(a[i, j, k]) - float(b[i, j, k])))
    return largest


@njit(cache=True, nogil=True)
def _histogram(a: Any, b: Any, both: bool, scale: float, bins: int) -> Any:  # pragma: no cover
    histogram = np.zeros(bins, np.int64)
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            for k in range(a.shape[2]):
                x, y = float(a[i, j, k]), float(b[i, j, k])
                if x != y and not (both and (x == 0 or y == 0)):
                    histogram[int(abs(x - y) * scale)] += 1
    return histogram


@njit(cache=True, nogil=True)
def _collect(  # pragma: no cover - compiled
    a: Any,
    b: Any,
    both: bool,
    scale: float,
    least: int,
    above: int,
    ties: int,
    wanted: int,
    rng: Any,
) -> Any:
    index = np.empty((above + wanted, 3), np.int64)
    found = 0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            for k in range(a.shape[2]):
                x, y = float(a[i, j, k]), float(b[i, j, k])
                if x == y or (both and (x == 0 or y == 0)):
                    continue
                level = int(abs(x - y) * scale)
                if level < least:
                    continue
                if level == least:
                    # Knuth's selection sampling: exactly `wanted` of the ties, each as likely.
                    take = rng.random() * ties < wanted
                    ties -= 1
                    if not take:
                        continue
                    wanted -= 1
                index[found, 0], index[found, 1], index[found, 2] = i, j, k
                found += 1
    return index[:found]


def largest_differences(
    current: NDArray[Any],
    previous: NDArray[Any],
    count: int,
    rng: np.random.Generator,
    *,
    both_seen: bool = False,
) -> tuple[NDArray[np.int64], float]:
    """Voxels with the largest absolute difference (Chatelain 2013, eq. 1).

    The threshold is the order statistic that leaves ``count`` voxels, found with a histogram: exact
    for uint8, in 4096 steps for floating point. 8-bit differences have many ties at the threshold;
    of those a random subset is taken, so that no part of the volume is preferred.

    Parameters
    ----------
    current, previous
        (nx, ny, nz) intensities of the same type.
    count
        Wanted number of voxels; fewer are returned only where fewer changed at all.
    rng
        Chooses among ties.
    both_seen
        Whether to leave out voxels that are zero in either volume: outside a sector that moves.

    Returns
    -------
    index, threshold
        (m, 3) indices of the voxels, and the least difference among them (0 where nothing changed).
    """
    if current.dtype == np.uint8:
        scale, bins = 1.0, 256
    else:
        largest = _largest_difference(current, previous)
        scale, bins = (_BINS - 1) / largest if largest > 0 else 1.0, _BINS
    histogram = _histogram(current, previous, both_seen, scale, bins)
    from_top = np.cumsum(histogram[::-1])[::-1]
    if from_top[0] == 0:
        return np.empty((0, 3), np.int64), 0.0
    if from_top[0] <= count:
        least = int(np.flatnonzero(histogram)[0])
    else:
        least = int(np.flatnonzero(from_top >= count)[-1])
    ties = int(histogram[least])
    above = int(from_top[least]) - ties
    wanted = min(count - above, ties)
    index = _collect(current, previous, both_seen, scale, least, above, ties, wanted, rng)
    return index, math.ceil(least) / scale
