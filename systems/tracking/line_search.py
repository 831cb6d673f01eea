"""Search of a whole volume for bright lines, each of which may be a needle."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.workers import by_parts
from sonoservo.systems.tracking.cells import Cells

Floats = NDArray[np.float64]

_STEEPEST = 0.92
"""Largest share of the depth's direction in the direction of a line that is searched for."""

_UNIT = 0.125
"""Unit of levels in dB. A half of a line has at most eleven cells, of at most 14 dB; their sum with
the other half's, times eleven, is still a short whole number."""

_DARK_SIDES, _UNEVEN = -8, 16
"""Level above the surroundings below which sides get no darker, as tissue between two shadows would
otherwise pass for a line; and largest contrast of a line above that of its darker half."""

HALF_LENGTH, _BESIDE, _STEP, _APART = 10e-3, 4.5e-3, 0.2, 4e-3
"""Half the length of a line and distance of the parallel lines in m, angle between neighbouring
directions in rad, and smallest distance in m between parallel lines that are two."""


_BLOCK = 4096
"""Number of cells whose lines are compared at a time; it decides about speed alone."""


@njit(cache=True, nogil=True)
def _line_contrasts(  # pragma: no cover - compiled
    levels: Any, margin: int, along: Any, beside: Any
) -> Any:
    """Return the largest contrast of a line centred on each cell, and the number of its direction.

    ``along`` (d, h) and ``beside`` (d, b) are differences of index, for a half of a line in each of
    d directions and the lines beside it. Contrasts are in `_UNIT`, times h and the cells of a line.
    """
    # All sums are of short whole numbers, many of which a processor adds at once; block by block,
    # so that they stay in its nearest memory.
    n, half = len(levels) - 2 * margin, np.int16(along.shape[1])
    cells_of_line = np.int16(2 * half + 1)
    best, direction = np.zeros(len(levels), np.int16), np.zeros(len(levels), np.int16)
    halves, whole = np.zeros(len(levels), np.int16), np.zeros(len(levels), np.int16)
    sides = np.zeros(_BLOCK, np.int16)
    dark, uneven = np.int16(_DARK_SIDES * cells_of_line), np.int16(_UNEVEN * half * cells_of_line)
    for d in range(len(along)):
        # Views that begin at zero let the compiler see that no index is negative.
        for first in range(margin, margin + n, _BLOCK):
            last = min(first + _BLOCK, margin + n)
            ahead = halves[first:last]
            ahead[:] = 0
            for s in range(half):
                cells = levels[first + along[d, s] : last + along[d, s]]
                for x in range(len(ahead)):
                    ahead[x] += cells[x]
        # The half behind a cell is the half ahead of the cell one half and a step behind.
        back = along[d, half - 1] + along[d, 0]
        centre, ahead = levels[margin : margin + n], halves[margin : margin + n]
        behind, line = halves[margin - back : margin - back + n], whole[margin : margin + n]
        for x in range(n):
            line[x] = ahead[x] + behind[x] + centre[x]
        number = np.int16(d)
        for first in range(margin, margin + n, _BLOCK):
            last = min(first + _BLOCK, margin + n)
            side = sides[: last - first]
            side[:] = dark
            for s in range(beside.shape[1]):
                other = whole[first + beside[d, s] : last + beside[d, s]]
                for x in range(len(side)):
                    side[x] = max(side[x], other[x])
            ahead, behind = halves[first:last], halves[first - back : last - back]
            line = whole[first:last]
            most, way = best[first:last], direction[first:last]
            for x in range(len(side)):
                # Every intermediate value is short, without a branch, for the compiler's vectors.
                darker = np.int16(np.int16(min(ahead[x], behind[x]) * cells_of_line) + uneven)
                contrast = np.int16(
                    min(np.int16(line[x] * half), darker) - np.int16(side[x] * half)
                )
                more = np.int16(contrast > most[x])
                most[x] = max(most[x], contrast)
                way[x] += np.int16(more * np.int16(number - way[x]))
    return best[margin : margin + n], direction[margin : margin + n]


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

    def contrasts(part: slice) -> tuple[Any, Any]:
        contrast, number = _line_contrasts(levels, margin, along[part], beside[part])
        return contrast, number + part.start

    (best, direction), *rest = by_parts(contrasts, len(along))
    for contrast, number in rest:
        better = contrast > best
        best, direction = np.where(better, contrast, best), np.where(better, number, direction)
    return best, direction


def bright_lines(cells: Cells, count: int) -> tuple[Floats, Floats]:
    """Return (n, 3) middles in P and unit vectors of lines that outshine all sides, best first.

    A line's contrast is its mean level above the brightest of the parallel lines beside it. Speckle
    averages out along it; a sheet is as bright beside it; an inclusion fills one half of it only.
    """
    levels, edges = cells.levels, cells.edges
    pitch = float(edges.mean())
    half = max(2, round(HALF_LENGTH / pitch))
    directions = _directions(_STEP)
    # A margin behind each row is also the one before the next.
    padded = np.pad(levels, ((0, 0), (0, half), (0, half)))
    strides = np.array([padded.shape[1] * padded.shape[2], padded.shape[2], 1])
    steps = np.arange(1, half + 1)[:, np.newaxis] * pitch
    along, aside = (
        np.round(each / edges).astype(np.int64) @ strides
        for each in (directions[:, np.newaxis] * steps, _BESIDE * _around(directions))
    )
    margin = 2 * int(max(np.abs(along).max(), np.abs(aside).max()))
    whole = np.pad(np.round(padded.ravel() / _UNIT).astype(np.int16), margin)
    contrast, number = _all_contrasts(whole, margin, along, aside)
    contrast = np.where(cells.seen, contrast.reshape(padded.shape)[:, :-half, :-half], 0).ravel()
    number = number.reshape(padded.shape)[:, :-half, :-half].ravel()

    order = np.argsort(-contrast, kind="stable")[: np.count_nonzero(contrast > 0)]
    index = np.stack(np.unravel_index(order, levels.shape), axis=1)
    centres = cells.origin + index * edges
    k = directions[number[order]]
    chosen = _select_lines(centres, k, count, _APART, HALF_LENGTH)
    return centres[chosen], k[chosen]
