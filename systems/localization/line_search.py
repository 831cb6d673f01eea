"""Search of a whole volume for bright lines, each of which may be a needle."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from sonoservo.systems.sampling.workers import workers
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_STEEPEST = 0.92
"""Largest share of the depth's direction in the direction of a line that is searched for."""

_DARKEST, _BRIGHTEST = -6.0, 14.0
"""Limits of a cell's level above its surroundings, in dB."""

_DARK_SIDES = -1.0
"""Level above the surroundings at which sides get no darker, in dB. Shadows would otherwise make
the tissue beside them a line."""

_UNEVEN = 2.0
"""Largest contrast of a line above that of its darker half, in dB."""

_MOST_CELLS = 50_000
"""Number of cells from which larger cells are used."""

_PARTS = 4
"""Number of parts in which the directions are tried."""


@njit(cache=True, nogil=True)
def _cell_levels(  # pragma: no cover - compiled
    intensities: Any, seen: Any, bx: int, by: int, bz: int
) -> Any:
    """Return the mean intensity of each block of voxels, and whether most of it was seen."""
    nx, ny, nz = intensities.shape
    means = np.zeros((nx // bx, ny // by, nz // bz), np.float32)
    shown = np.zeros(means.shape, np.bool_)
    for p in range(means.shape[0]):
        for q in range(means.shape[1]):
            for r in range(means.shape[2]):
                total, count = 0.0, 0
                for i in range(p * bx, p * bx + bx):
                    for j in range(q * by, q * by + by):
                        for k in range(r * bz, r * bz + bz):
                            total += intensities[i, j, k]
                            count += seen[i, j, k]
                if 2 * count >= bx * by * bz:
                    means[p, q, r], shown[p, q, r] = total / count, True
    return means, shown


@njit(cache=True, nogil=True)
def _line_contrasts(  # pragma: no cover - compiled
    levels: Any, margin: int, along: Any, beside: Any
) -> Any:
    """Return the largest contrast of a line centred on each cell, and the number of its direction.

    Parameters
    ----------
    levels
        (n,) levels of all cells above their surroundings in dB, with margins between their rows
        and a further one at either end.
    margin
        Length of the margin at either end.
    along, beside
        (d, h) and (d, b) differences of index between the centre of a line in each of d directions
        and the cells of one half of it, and between the line and those beside it.
    """
    n, half = len(levels) - 2 * margin, along.shape[1]
    best, direction = np.zeros(n, np.float32), np.zeros(n, np.int32)
    halves, whole = np.zeros(len(levels), np.float32), np.zeros(len(levels), np.float32)
    side = np.zeros(n, np.float32)
    per_half, per_line = np.float32(1 / half), np.float32(1 / (2 * half + 1))
    dark, uneven = np.float32(_DARK_SIDES), np.float32(_UNEVEN)
    centre = levels[margin : margin + n]
    for d in range(len(along)):
        # Views that begin at zero let the compiler see that no index is negative.
        ahead = halves[margin : margin + n]
        ahead[:] = 0
        for s in range(half):
            cells = levels[margin + along[d, s] : margin + along[d, s] + n]
            for x in range(n):
                ahead[x] += cells[x]
        # The half behind a cell is the half ahead of the cell one half and a step behind.
        back = along[d, half - 1] + along[d, 0]
        behind = halves[margin - back : margin - back + n]
        line = whole[margin : margin + n]
        for x in range(n):
            line[x] = (ahead[x] + behind[x] + centre[x]) * per_line
        side[:] = dark
        for s in range(beside.shape[1]):
            other = whole[margin + beside[d, s] : margin + beside[d, s] + n]
            for x in range(n):
                side[x] = max(side[x], other[x])
        for x in range(n):
            darker = min(ahead[x], behind[x]) * per_half
            contrast = min(line[x], darker + uneven) - side[x]
            if contrast > best[x]:
                best[x], direction[x] = contrast, d
    return best, direction


@njit(cache=True, nogil=True)
def _select_lines(  # pragma: no cover - compiled
    centres: Any, directions: Any, count: int, aside: float, apart: float
) -> Any:
    """Return the numbers of the first lines that do not lie along an earlier one."""
    chosen = np.empty(count, np.int64)
    n = 0
    for c in range(len(centres)):
        if n == count:
            break
        alike = False
        for m in range(n):
            d, k = centres[c] - centres[chosen[m]], directions[chosen[m]]
            along = np.sum(d * k)
            away = np.sum(d * d) - along * along
            if away < aside * aside and abs(along) < apart and abs(np.sum(directions[c] * k)) > 0.9:
                alike = True
                break
        if not alike:
            chosen[n] = c
            n += 1
    return chosen[:n]


@lru_cache(maxsize=8)
def _directions(step: float) -> Floats:
    """Return (d, 3) unit vectors about ``step`` rad apart, one of each pair of opposite ones."""
    levels = round(math.pi / 2 / step)
    vectors = []
    for elevation in step * np.arange(-levels, levels + 1):
        if abs(math.sin(elevation)) <= _STEEPEST:
            count = max(1, round(math.pi * math.cos(elevation) / step))
            for azimuth in math.pi / count * np.arange(count):
                x, z = math.cos(azimuth), math.sin(azimuth)
                flat = math.cos(elevation)
                vectors.append((flat * x, math.sin(elevation), flat * z))
    return np.array(vectors)


def _around(directions: Floats, count: int = 8) -> Floats:
    """Return (d, count, 3) unit vectors perpendicular to each of (d, 3) others."""
    u = np.cross(directions, [0.0, 1.0, 0.0])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    w = np.cross(directions, u)
    angles = 2 * np.pi / count * np.arange(count)[:, np.newaxis]
    return np.asarray(np.cos(angles) * u[:, np.newaxis] + np.sin(angles) * w[:, np.newaxis])


def _all_contrasts(levels: Any, margin: int, along: Any, beside: Any) -> tuple[Any, Any]:
    """Return what `_line_contrasts` does, from as many threads as there are."""

    def contrasts(part: NDArray[np.int64]) -> tuple[Any, Any]:
        contrast, number = _line_contrasts(levels, margin, along[part], beside[part])
        return contrast, number + part[0]

    pool, parts = workers(), np.array_split(np.arange(len(along)), _PARTS)
    (best, direction), *rest = map(contrasts, parts) if pool is None else pool.map(contrasts, parts)
    for contrast, number in rest:
        better = contrast > best
        best, direction = np.where(better, contrast, best), np.where(better, number, direction)
    return best, direction


def bright_lines(
    volume: Volume,
    *,
    count: int = 40,
    cell: float = 1.5e-3,
    half_length: float = 10e-3,
    beside: float = 4.5e-3,
    around: float = 13e-3,
    step: float = 0.2,
) -> list[Floats]:
    """Find the lines of a volume that are brighter than their surroundings on all sides.

    The volume is reduced to the mean levels of cells above the tissue around them. A line's level
    is the mean of the cells along it, and its contrast is that level above the brightest of the
    parallel lines beside it. Speckle is averaged along the line; a sheet is as bright beside the
    line as on it; a compact inclusion fills one half of the line only. All cells and directions
    are tried.

    Parameters
    ----------
    volume
        Volume to search.
    count
        Largest number of lines.
    cell
        Smallest edge length of the cells, in m.
    half_length
        Half the length of a line, in m.
    beside
        Distance of the parallel lines, in m.
    around
        Edge length of the cube over which the level around a cell is averaged, in m.
    step
        Angle between neighbouring directions, in rad.

    Returns
    -------
    Lines, most prominent first, each (2, 3): ends in the probe frame, in m.
    """
    cell = max(cell, float(np.prod(volume.upper - volume.origin) / _MOST_CELLS) ** (1 / 3))
    size = np.maximum(1, np.round(cell / volume.spacing)).astype(int)
    edges = size * volume.spacing
    means, seen = _cell_levels(volume.intensities, volume.seen, *size)
    means *= np.float32(volume.decibels_per_level)
    if not means.any():
        return []
    window = np.maximum(3, np.round(around / edges)).astype(int)
    share = uniform_filter(seen.astype(np.float32), window, mode="constant")
    level = uniform_filter(means, window, mode="constant") / np.maximum(share, 0.05)
    levels = np.where(seen, np.clip(means - level, _DARKEST, _BRIGHTEST), np.float32(0))

    pitch = float(edges.mean())
    half = max(2, round(half_length / pitch))
    directions = _directions(step)
    # A margin behind each row is also the one before the next.
    padded = np.pad(levels, ((0, 0), (0, half), (0, half)))
    strides = np.array([padded.shape[1] * padded.shape[2], padded.shape[2], 1])
    steps = np.arange(1, half + 1)[:, np.newaxis] * pitch
    along, aside = (
        np.round(each / edges).astype(np.int64) @ strides
        for each in (directions[:, np.newaxis] * steps, beside * _around(directions))
    )
    margin = 2 * int(max(np.abs(along).max(), np.abs(aside).max()))
    contrast, number = _all_contrasts(np.pad(padded.ravel(), margin), margin, along, aside)
    contrast = np.where(seen, contrast.reshape(padded.shape)[:, :-half, :-half], 0).ravel()
    number = number.reshape(padded.shape)[:, :-half, :-half].ravel()

    order = np.argsort(-contrast)[: np.count_nonzero(contrast > 0)]
    index = np.stack(np.unravel_index(order, levels.shape), axis=1)
    centres = volume.position((index + 0.5) * size - 0.5)
    k = directions[number[order]]
    chosen = _select_lines(centres, k, count, 4e-3, half_length)
    reach = half * pitch * np.array([[-1.0], [1.0]])
    return [centres[c] + reach * k[c] for c in chosen]
