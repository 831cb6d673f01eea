"""Fit of lines: moved across themselves to where a volume is brightest along them."""

from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.interpolation import trilinear
from sonoservo.systems.sampling.workers import by_parts
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.cells import Cells
from sonoservo.systems.tracking.line_contrast import BIN, MIDDLES, across, line_levels, stretches
from sonoservo.systems.tracking.line_search import HALF_LENGTH, bright_lines

Floats = NDArray[np.float64]

LINES = 100
"""Number of bright lines of a volume that are fitted. A needle is among the first 100 of a volume
of the harder world in nine of ten."""

_REACHES = (4e-3, 3e-3, 2e-3)
"""Largest displacements of the ends in successive fits, in m: first the distance between the lines
that are searched, then less."""

_STEPS = np.array([1e-3, 0.5e-3])
"""Displacements that are tried, in m: about a voxel or two, and half of that."""

_SHORTEST = 3
"""Smallest number of bins of a line."""

_LEAST = 6.0
"""Log likelihood ratio of a stretch that lines through speckle alone reach."""


@dataclass(frozen=True, eq=False)
class FittedLine:
    """A line that is brighter than what lies beside it, with (2, 3) ends in P, in m."""

    ends: Floats
    brightness: float
    """Sum of its bins' contrasts in dB, by which fits of one line are compared."""
    evidence: float
    """Sum of its bins' log likelihood ratios, of a line against nothing."""


@njit(cache=True, nogil=True, error_model="numpy")
def _mean_level(  # pragma: no cover - compiled
    intensities: Any, seen: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float,
    count: int,
) -> float:  # fmt: skip
    """Return the mean grey level of steps from fractional indices; 0 if less than half is seen."""
    nx, ny, nz = intensities.shape
    total, number = 0.0, 0
    for _ in range(count):
        inside = 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1
        if inside and seen[int(x + 0.5), int(y + 0.5), int(z + 0.5)]:
            total += trilinear(intensities, x, y, z)
            number += 1
        x += dx
        y += dy
        z += dz
    return total / number if 2 * number > count else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _brightest_line(  # pragma: no cover - compiled
    intensities: Any, seen: Any, start: Any, stop: Any, across: Any, count: int, reach: float,
    steps: Any,
) -> Any:  # fmt: skip
    """Return the (2, 2) displacements in m of a line's ends that make its mean level largest.

    ``start`` and ``stop`` are fractional indices, and ``across`` (2, 3) indices per m. The
    ``steps`` in m are tried in turn, coarse ones first, up to ``reach``.
    """
    best, moved, before = -1.0, np.zeros((2, 2)), np.zeros((2, 2))
    first, last = np.zeros(3), np.zeros(3)
    for number in range(len(steps)):
        far = 2 if number == 0 else 1
        for turn in range(4):
            # The ends are moved alike and in opposite directions in turn.
            sense = 1.0 if turn % 2 == 0 else -1.0
            for end in range(2):  # by element: it compiles seconds faster than a slice
                before[end, 0], before[end, 1] = moved[end, 0], moved[end, 1]
            for i in range(-far, far + 1):
                for j in range(-far, far + 1):
                    p, q = steps[number] * i, steps[number] * j
                    a, b = before[0, 0] + p, before[0, 1] + q
                    c, d = before[1, 0] + sense * p, before[1, 1] + sense * q
                    if max(abs(a), abs(b), abs(c), abs(d)) > reach:
                        continue
                    for axis in range(3):
                        first[axis] = start[axis] + a * across[0, axis] + b * across[1, axis]
                        last[axis] = stop[axis] + c * across[0, axis] + d * across[1, axis]
                    dx = (last[0] - first[0]) / count
                    dy = (last[1] - first[1]) / count
                    dz = (last[2] - first[2]) / count
                    level = _mean_level(
                        intensities, seen, first[0] + dx / 2, first[1] + dy / 2, first[2] + dz / 2,
                        dx, dy, dz, count,
                    )  # fmt: skip
                    if level > best + 1e-6:
                        best = level
                        moved[0, 0], moved[0, 1], moved[1, 0], moved[1, 1] = a, b, c, d
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def _brightest_lines(  # pragma: no cover - compiled
    intensities: Any, seen: Any, ends: Any, across: Any, counts: Any, reach: float, steps: Any
) -> Any:
    """Return the (n, 2, 2) displacements of the ends of lines; see `_brightest_line`."""
    moved = np.zeros((len(ends), 2, 2))
    for n in range(len(ends)):
        moved[n] = _brightest_line(
            intensities, seen, ends[n, 0], ends[n, 1], across[n], counts[n], reach, steps
        )
    return moved


def brightness(contrasts: NDArray[Any]) -> Floats:
    """Return (n,) sums of the contrasts in dB of the most evident stretches of lines."""
    firsts, lasts, _ = stretches(contrasts)
    totals = np.nancumsum(contrasts, axis=1, dtype=np.float64)
    totals = np.pad(totals, ((0, 0), (1, 0)))
    rows = np.arange(len(totals))
    return np.asarray(totals[rows, lasts + 1] - totals[rows, firsts])


def fitted_lines(volume: Volume, cells: Cells, count: int = LINES) -> list[FittedLine]:
    """Return up to ``count`` bright lines, each moved to where it is brightest, brightest first."""
    middles, k = bright_lines(cells, count)

    def fitted(part: slice) -> list[FittedLine]:
        return _fitted(volume, middles[part], k[part])

    lines = list(chain(*by_parts(fitted, len(middles))))
    return sorted(lines, key=lambda line: -line.brightness)


def _fitted(volume: Volume, middles: Floats, k: Floats) -> list[FittedLine]:
    """Return those of the lines through (n, 3) middles in P along unit vectors that are lines."""
    ends = middles[:, np.newaxis] + HALF_LENGTH * np.array([[-1.0], [1.0]]) * k[:, np.newaxis]
    values = sums = np.zeros(len(ends))
    for reach in _REACHES:
        along = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(along, axis=1)
        sides = across(along / length[:, np.newaxis])
        moved = _brightest_lines(
            volume.intensities,
            volume.seen,
            volume.index(ends),
            np.ascontiguousarray(sides / volume.spacing),
            np.maximum(np.round(length / 1e-3), 8).astype(np.int64),
            reach,
            _STEPS,
        )
        ends = ends + moved @ sides
        middles = ends.mean(axis=1)
        along = ends[:, 1] - ends[:, 0]
        k = along / np.linalg.norm(along, axis=1, keepdims=True)
        contrasts = line_levels(volume, middles, k).contrasts
        firsts, lasts, evidence = stretches(contrasts)
        found = np.flatnonzero((lasts - firsts + 1 >= _SHORTEST) & (evidence >= _LEAST))
        a = np.stack([MIDDLES[firsts[found]] - BIN / 2, MIDDLES[lasts[found]] + BIN / 2], axis=1)
        ends = middles[found, np.newaxis] + a[..., np.newaxis] * k[found, np.newaxis]
        values, sums = brightness(contrasts[found]), evidence[found]
    return [FittedLine(*line) for line in zip(ends, values.tolist(), sums.tolist(), strict=True)]
