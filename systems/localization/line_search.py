"""Search of a whole volume for bright lines, each of which may be a needle."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from sonoservo.systems.signals.volume import Volume

_DIRECTIONS = np.array(
    [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0)]
)
"""Normals of 13 planes through a block, one of each pair of opposite neighbours."""

_CRESTS = 7
"""Number of these normals along which a candidate is no darker than its two neighbours."""

_EMPTY = 4.0
"""Loss of a line's score for each block's length without a candidate, in dB."""

_INNER, _OUTER = 1.6, 3.0
"""Distances from a line between which candidates count against it, as multiples of the largest
distance of its own."""

_MOST = 15.0
"""Largest contribution of a candidate to a line's score, in dB."""


@njit(cache=True, nogil=True)
def _block_maxima(intensities: Any, bx: int, by: int, bz: int) -> Any:  # pragma: no cover
    """Return the largest value in each block of voxels."""
    nx, ny, nz = intensities.shape
    maxima = np.zeros(
        ((nx + bx - 1) // bx, (ny + by - 1) // by, (nz + bz - 1) // bz), intensities.dtype
    )
    row = np.zeros(nz, intensities.dtype)
    for p in range(maxima.shape[0]):
        for q in range(maxima.shape[1]):
            row[:] = 0
            for i in range(p * bx, min(p * bx + bx, nx)):
                for j in range(q * by, min(q * by + by, ny)):
                    for k in range(nz):
                        row[k] = max(row[k], intensities[i, j, k])
            for k in range(nz):
                maxima[p, q, k // bz] = max(maxima[p, q, k // bz], row[k])
    return maxima


@njit(cache=True, nogil=True)
def _brightest_voxels(  # pragma: no cover - compiled
    intensities: Any, blocks: Any, bx: int, by: int, bz: int
) -> Any:
    """Return the (m, 3) index of the brightest voxel in each of (m, 3) blocks."""
    nx, ny, nz = intensities.shape
    index = np.zeros(blocks.shape, np.int64)
    for m in range(len(blocks)):
        p, q, r = blocks[m]
        most = -1.0
        for i in range(p * bx, min(p * bx + bx, nx)):
            for j in range(q * by, min(q * by + by, ny)):
                for k in range(r * bz, min(r * bz + bz, nz)):
                    if intensities[i, j, k] > most:
                        most = float(intensities[i, j, k])
                        index[m, 0], index[m, 1], index[m, 2] = i, j, k
    return index


@njit(cache=True, nogil=True)
def _prominence(  # pragma: no cover - compiled
    maxima: Any, mean: Any, directions: Any, reach: Any
) -> Any:
    """Return by how much each block exceeds both sides of all planes through it but two.

    A line runs along up to two of the normals, so it is not darker on their sides. Blocks that
    exceed no sides have zero.
    """
    nx, ny, nz = maxima.shape
    result = np.zeros(maxima.shape, np.float32)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                level = float(maxima[i, j, k])
                crests = 0
                for d in range(len(directions)):
                    beside = 0.0
                    p, q, r = i + directions[d, 0], j + directions[d, 1], k + directions[d, 2]
                    if 0 <= p < nx and 0 <= q < ny and 0 <= r < nz:
                        beside = float(maxima[p, q, r])
                    p, q, r = i - directions[d, 0], j - directions[d, 1], k - directions[d, 2]
                    if 0 <= p < nx and 0 <= q < ny and 0 <= r < nz:
                        beside = max(beside, float(maxima[p, q, r]))
                    crests += level >= beside
                    if crests + len(directions) - 1 - d < _CRESTS:
                        break
                if level == 0 or crests < _CRESTS:
                    continue
                first = second = third = 1e9
                for d in range(len(directions)):
                    dp, dq = directions[d, 0] * reach[0], directions[d, 1] * reach[1]
                    dr = directions[d, 2] * reach[2]
                    beside = 0.0
                    p, q, r = i + dp, j + dq, k + dr
                    if 0 <= p < nx and 0 <= q < ny and 0 <= r < nz:
                        beside = max(mean[p, q, r], float(maxima[p, q, r]))
                    p, q, r = i - dp, j - dq, k - dr
                    if 0 <= p < nx and 0 <= q < ny and 0 <= r < nz:
                        beside = max(beside, mean[p, q, r], float(maxima[p, q, r]))
                    drop = level - beside
                    if drop < third:
                        if drop < second:
                            third = second
                            if drop < first:
                                second, first = first, drop
                            else:
                                second = drop
                        else:
                            third = drop
                        if third <= 0:
                            break
                result[i, j, k] = max(third, 0.0)
    return result


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _score_lines(  # pragma: no cover - compiled
    points: Any, strength: Any, distance: float, shortest: float, longest: float, pitch: float
) -> Any:
    """Score the line through each pair of points by the candidates that follow one another on it.

    Returns
    -------
    (n, 2) numbers of the points of each pair, (n,) scores, and (n, 2) abscissae of the ends of the
    best stretch from the first point.
    """
    bins = 512
    m = len(points)
    pairs = np.empty((m * (m - 1) // 2, 2), np.int32)
    scores = np.empty(len(pairs), np.float32)
    ends = np.empty((len(pairs), 2))
    best, beside = np.zeros(bins, np.float32), np.zeros(bins, np.float32)
    x, y, z = np.empty(m, np.float32), np.empty(m, np.float32), np.empty(m, np.float32)
    squared, along, away = np.empty_like(x), np.empty_like(x), np.empty_like(x)
    limit = np.float32(distance * distance)
    inner, outer = np.float32(_INNER**2) * limit, np.float32(_OUTER**2) * limit
    n = 0
    for i in range(m):
        for c in range(m):
            x[c], y[c] = points[c, 0] - points[i, 0], points[c, 1] - points[i, 1]
            z[c] = points[c, 2] - points[i, 2]
            squared[c] = x[c] * x[c] + y[c] * y[c] + z[c] * z[c]
        for j in range(i + 1, m):
            length = np.sqrt(squared[j])
            if length < shortest or length > longest:
                continue
            kx, ky, kz = x[j] / length, y[j] / length, z[j] / length
            for c in range(m):
                along[c] = x[c] * kx + y[c] * ky + z[c] * kz
                away[c] = squared[c] - along[c] * along[c]
            low, high = bins, -1
            for c in range(m):
                if away[c] < outer:
                    at = min(max(int(np.floor(along[c] / pitch)) + bins // 2, 0), bins - 1)
                    low, high = min(low, at), max(high, at)
                    if away[c] < limit:
                        best[at] = max(best[at], strength[c])
                    elif away[c] > inner:
                        beside[at] = max(beside[at], strength[c])
            start, total, most, first, last = low, 0.0, 0.0, low, low
            for at in range(low, high + 1):
                if total <= 0:
                    start, total = at, 0.0
                total += max(best[at] - beside[at], -_EMPTY) if best[at] > 0 else -_EMPTY
                best[at] = beside[at] = 0
                if total > most:
                    most, first, last = total, start, at
            pairs[n, 0], pairs[n, 1], scores[n] = i, j, most
            ends[n, 0] = (first - bins // 2) * pitch
            ends[n, 1] = (last + 1 - bins // 2) * pitch
            n += 1
    return pairs[:n], scores[:n], ends[:n]


@njit(cache=True, nogil=True)
def _select_lines(  # pragma: no cover - compiled
    points: Any, pairs: Any, scores: Any, ends: Any, count: int, distance: float
) -> Any:
    """Return the (n, 2, 3) ends of the first lines that do not lie along an earlier one."""
    lines = np.empty((count, 2, 3))
    n = 0
    for c in range(len(pairs)):
        if n == count or scores[c] <= 0:
            break
        first = points[pairs[c, 0]]
        k = points[pairs[c, 1]] - first
        k = k / np.sqrt(np.sum(k * k))
        for axis in range(3):
            lines[n, 0, axis] = first[axis] + ends[c, 0] * k[axis]
            lines[n, 1, axis] = first[axis] + ends[c, 1] * k[axis]
        alike = False
        for other in range(n):
            start = lines[other, 0]
            d = lines[other, 1] - start
            length = np.sqrt(np.sum(d * d))
            d = d / length
            first_a, last_a = np.sum((lines[n, 0] - start) * d), np.sum((lines[n, 1] - start) * d)
            if max(first_a, last_a) < 0 or min(first_a, last_a) > length:
                continue
            away = max(
                np.sum((lines[n, 0] - start) ** 2) - first_a**2,
                np.sum((lines[n, 1] - start) ** 2) - last_a**2,
            )
            if away < distance * distance:
                alike = True
                break
        n += not alike
    return lines[:n]


def bright_lines(
    volume: Volume,
    *,
    count: int = 8,
    block: float = 2.2e-3,
    reach: NDArray[np.float64] | float = 4.4e-3,
    points: int = 350,
    distance: float = 2.2e-3,
    shortest: float = 6e-3,
    longest: float = 30e-3,
) -> list[NDArray[np.float64]]:
    """Find the lines of a volume that are brighter than their surroundings on all sides.

    The volume is reduced to the maxima of blocks. A block on a line is brighter than both sides of
    every plane through it, except for planes that the line crosses. A block on a sheet is as bright
    as the rest of the sheet, and a block on an edge is darker than the brighter side. The blocks
    that stand out most are the candidates. The line through each pair of them is scored by the
    candidates that follow one another along it. Compact inclusions therefore score low, however
    bright they are.

    Parameters
    ----------
    volume
        Volume to search.
    count
        Largest number of lines.
    block
        Edge length of the blocks, in m.
    reach
        Distance from a block to its sides, in m; one number, or (3,) along X, Y and Z.
    points
        Number of candidates.
    distance
        Largest distance of a line's candidates from it, in m.
    shortest, longest
        Limits of the distance between the points of a pair, in m.

    Returns
    -------
    Lines, most prominent first, each (2, 3): ends in the probe frame, in m.
    """
    size = np.maximum(1, np.round(block / volume.spacing)).astype(int)
    maxima = _block_maxima(volume.intensities, *size)
    share = uniform_filter((maxima > 0).astype(np.float32), 3, mode="constant")
    total = uniform_filter(maxima.astype(np.float32), 3, mode="constant")
    mean = np.where(share > 0.3, total / np.maximum(share, 0.3), 0).astype(np.float32)
    steps = np.maximum(2, np.round(reach / (size * volume.spacing))).astype(int)
    prominence = _prominence(maxima, mean, _DIRECTIONS, steps).ravel()
    chosen = np.argpartition(prominence, -min(points, prominence.size))[-points:]
    chosen = chosen[prominence[chosen] > 0]
    blocks = np.stack(np.unravel_index(chosen, maxima.shape), axis=1)
    p_P = volume.position(_brightest_voxels(volume.intensities, blocks, *size))
    strength = np.minimum(volume.decibels_per_level * prominence[chosen], _MOST)
    strength = strength.astype(np.float32)
    pairs, scores, ends = _score_lines(p_P, strength, distance, shortest, longest, block)
    order = np.argsort(-scores, kind="stable")
    return list(_select_lines(p_P, pairs[order], scores[order], ends[order], count, 2 * distance))
