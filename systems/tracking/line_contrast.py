"""Contrast of a line with what lies beside it, and its likelihood if the line is there or not."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.interpolation import trilinear
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

BIN = 2e-3
"""Length of a bin along a line, in m, about the length of its echo."""

BINS = 70
"""Number of bins along a line: as far as a needle can be seen in either direction."""

MIDDLES: Floats = BIN * (np.arange(BINS, dtype=np.float64) - 0.5 * (BINS - 1))
"""(BINS,) abscissae of the bins' middles, in m."""

_CORE, _RING = 0.6e-3, 4.5e-3
"""Radius in m over which a line's echo is averaged, and of the ring beside it, outside the beam."""

_AVERAGED = 2
"""Number of bins to either side over which a sector of the ring is averaged, against speckle."""

_LINE, _NOTHING = ((4.6, 3.0), (8.0, 8.0)), ((-1.2, 1.8), (1.0, 6.0))
"""Means and standard deviations in dB of two Gaussians each: contrasts of a line that shows itself,
and of nothing. Fitted to volumes of the harder world along true needles and beyond their tips."""

_RARE = 0.06
"""Share of the second Gaussian."""

_DARKEST, _BRIGHTEST = -8.0, 25.0
"""Contrasts in dB below and above which a bin tells no more, as something bright lies beside the
line, and as its brightest echo is none that was fitted."""

_SUREST = 3.3
"""Largest logarithm of the ratio that a bin can contribute, as some structures are not modelled."""

_TAIL = 5.0
"""Degrees of freedom of Student's distribution of the differences between levels that repeat
themselves: places are sampled more exactly in one volume than in another. Chosen by
``python -m line_study --tails`` (tests/tools), with the probe still, moving, and in breath."""

_PEAK = math.gamma(0.5 * (_TAIL + 1)) / math.gamma(0.5 * _TAIL) * math.sqrt(2 / _TAIL)
"""Its density at 0, relative to that of a Gaussian."""

_ROUNDS, _SETTLED = 100, 1e-5
"""Largest number of rounds of `change_between`, and change of the share from one to the next that
ends it."""


@njit(cache=True, nogil=True, error_model="numpy")
def _core(intensities: Any, x: float, y: float, z: float, across: Any) -> float:
    """Return five times the mean level of a line's echo at fractional indices."""
    nx, ny, nz = intensities.shape
    level = trilinear(intensities, x, y, z)
    for q in range(4):
        c = _CORE * (1 - 2 * (q % 2))
        p = x + c * across[q // 2, 0]
        r = y + c * across[q // 2, 1]
        t = z + c * across[q // 2, 2]
        if 0 <= p <= nx - 1 and 0 <= r <= ny - 1 and 0 <= t <= nz - 1:
            level += trilinear(intensities, p, r, t)
    return level


@njit(cache=True, nogil=True, error_model="numpy")
def _side(intensities: Any, volume_seen: Any, x: float, y: float, z: float) -> Any:
    """Return the level at fractional indices, and whether it was seen."""
    nx, ny, nz = intensities.shape
    inside = 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1
    if inside and volume_seen[int(x + 0.5), int(y + 0.5), int(z + 0.5)]:
        return trilinear(intensities, x, y, z), 1
    return 0.0, 0


@njit(cache=True, nogil=True, error_model="numpy")
def _line_levels(  # pragma: no cover - compiled
    intensities: Any, volume_seen: Any, starts: Any, steps: Any, across: Any, count: int
) -> Any:
    """Return (n, count) grey levels of lines, and beside them; NaN where they are not seen.

    ``starts`` and ``steps`` are fractional indices, and ``across`` (n, 2, 3) indices per m. The
    level beside is that of the second brightest of eight sectors: a sheet has two as bright as the
    line.
    """
    nx, ny, nz = intensities.shape
    levels = np.full((len(starts), count), np.nan, np.float32)
    beside = np.full((len(starts), count), np.nan, np.float32)
    seen, core, sides = np.zeros(count, np.bool_), np.zeros(count), np.zeros((count, 8))
    valid = np.zeros((count, 8), np.int64)
    offsets = np.zeros((8, 3))
    for n in range(len(starts)):
        for s in range(8):
            c, d = _RING * math.cos(s * math.pi / 4), _RING * math.sin(s * math.pi / 4)
            for axis in range(3):
                offsets[s, axis] = c * across[n, 0, axis] + d * across[n, 1, axis]
        for b in range(count):
            seen[b], core[b] = True, 0.0
            for half in range(2):
                a = b + 0.5 * half - 0.25
                x = starts[n, 0] + a * steps[n, 0]
                y = starts[n, 1] + a * steps[n, 1]
                z = starts[n, 2] + a * steps[n, 2]
                if (
                    not (1 <= x <= nx - 2 and 1 <= y <= ny - 2 and 1 <= z <= nz - 2)
                    or not (volume_seen[int(x + 0.5), int(y + 0.5), int(z + 0.5)])
                ):
                    seen[b] = False
                    break
                core[b] += 0.1 * _core(intensities, x, y, z, across[n])
            for s in range(8):
                valid[b, s], sides[b, s] = 0, 0.0
                if not seen[b]:
                    continue
                for half in range(2):
                    a = b + 0.5 * half - 0.25
                    x = starts[n, 0] + a * steps[n, 0] + offsets[s, 0]
                    y = starts[n, 1] + a * steps[n, 1] + offsets[s, 1]
                    z = starts[n, 2] + a * steps[n, 2] + offsets[s, 2]
                    # Averages over the ring need no interpolation.
                    if -0.5 < x < nx - 0.5 and -0.5 < y < ny - 0.5 and -0.5 < z < nz - 0.5:
                        i, j, k = int(x + 0.5), int(y + 0.5), int(z + 0.5)
                        if volume_seen[i, j, k]:
                            sides[b, s] += intensities[i, j, k]
                            valid[b, s] += 1
        for b in range(count):
            if seen[b]:
                first, last = max(b - _AVERAGED, 0), min(b + _AVERAGED + 1, count)
                brightest, second = 0.0, 0.0
                for s in range(8):
                    total, number = 0.0, 0
                    for e in range(first, last):
                        total += sides[e, s]
                        number += valid[e, s]
                    if number > last - first:
                        total /= number
                        if total > brightest:
                            brightest, second = total, brightest
                        elif total > second:
                            second = total
                levels[n, b], beside[n, b] = core[b], second
    return levels, beside


@njit(cache=True, nogil=True, error_model="numpy")
def _cross_sections(  # pragma: no cover - compiled
    intensities: Any, volume_seen: Any, starts: Any, steps: Any, across: Any, radii: Any, count: int
) -> Any:
    """Return (n,) grey levels of lines, (n, r, 8) of sectors around them, and shares seen.

    Arguments as of `_line_levels`, and (r,) radii of the circles in m.
    """
    lines, circles = len(starts), len(radii)
    cores = np.zeros(lines)
    sides, shares = np.zeros((lines, circles, 8)), np.zeros((lines, circles, 8))
    for n in range(lines):
        found = 0
        for b in range(count):
            x = starts[n, 0] + b * steps[n, 0]
            y = starts[n, 1] + b * steps[n, 1]
            z = starts[n, 2] + b * steps[n, 2]
            if _side(intensities, volume_seen, x, y, z)[1]:
                cores[n] += 0.2 * _core(intensities, x, y, z, across[n])
                found += 1
            for r in range(circles):
                for s in range(8):
                    c = radii[r] * math.cos(s * math.pi / 4)
                    d = radii[r] * math.sin(s * math.pi / 4)
                    level, seen = _side(
                        intensities,
                        volume_seen,
                        x + c * across[n, 0, 0] + d * across[n, 1, 0],
                        y + c * across[n, 0, 1] + d * across[n, 1, 1],
                        z + c * across[n, 0, 2] + d * across[n, 1, 2],
                    )
                    sides[n, r, s] += level
                    shares[n, r, s] += seen
        cores[n] /= max(found, 1)
        for r in range(circles):
            for s in range(8):
                sides[n, r, s] /= max(shares[n, r, s], 1.0)
                shares[n, r, s] /= count
    return cores, sides, shares


def across(directions: Floats) -> Floats:
    """Return (n, 2, 3) unit vectors across (n, 3) directions in P; the first ones are level."""
    x, y, z = directions.T
    flat = np.hypot(x, z)
    level = np.maximum(flat, 1e-9)
    u, w = np.where(flat > 1e-6, [-z / level, x / level], [[1.0], [0.0]])
    sides = [[u, np.zeros_like(u), w], [y * w, z * u - x * w, -y * u]]
    return np.moveaxis(np.array(sides), 2, 0)


class LineLevels(NamedTuple):
    """(n, BINS) levels of lines and contrasts with the second brightest side, in dB; NaN unseen."""

    levels: NDArray[np.float32]
    contrasts: NDArray[np.float32]

    def where(self, seen: NDArray[np.bool_]) -> "LineLevels":
        """Return the levels and contrasts where a flag is set; NaN elsewhere."""
        return LineLevels(*(np.where(seen, each, np.float32(np.nan)) for each in self))


def line_levels(volume: Volume, points: Floats, directions: Floats) -> LineLevels:
    """Return the levels and contrasts along lines through (n, 3) points in P, in m."""
    levels, beside = _line_levels(
        volume.intensities,
        volume.seen,
        volume.index(points + MIDDLES[0] * directions),
        BIN * directions / volume.spacing,
        np.ascontiguousarray(across(directions) / volume.spacing),
        BINS,
    )
    scale = np.float32(volume.decibels_per_level)
    return LineLevels(levels * scale, (levels - beside) * scale)


def cross_sections(
    volume: Volume, ends: Floats, radii: Floats, count: int = 24
) -> tuple[Floats, NDArray[np.float64]]:
    """Return the mean cross-sections of lines between (n, 2, 3) ends in P.

    They are averages over ``count``: (n, r, 8) levels in dB of the line above the sectors of
    circles of (r,) radii in m, NaN where unseen, and the shares seen. The first sector lies level
    beside the line, the third above.
    """
    along = ends[:, 1] - ends[:, 0]
    directions = along / np.linalg.norm(along, axis=1, keepdims=True)
    cores, sides, shares = _cross_sections(
        volume.intensities,
        volume.seen,
        volume.index(ends[:, 0]),
        along / (count - 1) / volume.spacing,
        across(directions) / volume.spacing,
        radii,
        count,
    )
    contrasts = volume.decibels_per_level * (cores[:, np.newaxis, np.newaxis] - sides)
    return np.where(shares > 0, contrasts, np.nan), shares


@njit(cache=True, nogil=True, error_model="numpy")
def _density(contrast: float, parts: Any) -> float:  # pragma: no cover - compiled
    (mean, std), (rare_mean, rare_std) = parts
    usual = math.exp(-0.5 * ((contrast - mean) / std) ** 2) / std
    rare = math.exp(-0.5 * ((contrast - rare_mean) / rare_std) ** 2) / rare_std
    return (1 - _RARE) * usual + _RARE * rare


@njit(cache=True, nogil=True, error_model="numpy")
def _densities(contrasts: Any) -> Any:  # pragma: no cover - compiled
    """Return (2, n) densities of contrasts in dB of a line and of nothing, up to a constant."""
    result = np.full((2, len(contrasts)), math.nan)
    for n in range(len(contrasts)):
        if not math.isnan(contrasts[n]):
            contrast = min(max(contrasts[n], _DARKEST), _BRIGHTEST)
            line, nothing = _density(contrast, _LINE), _density(contrast, _NOTHING)
            # What is not modelled is as rare a line as it is nothing.
            other = math.exp(-_SUREST)
            result[0, n] = max(line, other * nothing)
            result[1, n] = max(nothing, other * line)
    return result


def _line_and_nothing(contrasts: NDArray[Any]) -> Floats:
    """Return the densities of contrasts in dB, NaN where unseen: of a line, and of nothing."""
    return np.asarray(_densities(contrasts.reshape(-1))).reshape(2, *contrasts.shape)


def log_ratio(contrasts: NDArray[Any]) -> Floats:
    """Return the logarithms of the likelihood ratios of contrasts in dB: a line against nothing."""
    line, nothing = _line_and_nothing(contrasts)
    return np.asarray(np.log(line / nothing))


class Change(NamedTuple):
    """How levels along lines change from one volume to the next."""

    renewed: float
    """Share of the bins that are drawn anew: other speckle, a shadow, a surface that shines."""
    scale: float
    """Scale in dB of the differences of levels that repeat themselves, by noise and misplaced
    sampling."""

    def since(self, before: "Change") -> "Change":
        """Return the change over two steps, of which this is the second."""
        return self._replace(renewed=1 - (1 - self.renewed) * (1 - before.renewed))


ALL_NEW = Change(1.0, 1.0)
"""Change since a volume that did not show the line."""


def repeat_ratio(now: LineLevels, before: NDArray[Any], change: Change) -> Floats:
    """Return the densities of levels that repeat those before, relative to those of nothing new.

    ``before`` are (n, BINS) levels in dB, NaN where they were not seen; so is the result.
    """
    steps = np.asarray(now.levels - before, np.float64)
    return _repeats(steps**2 / change.scale**2) / change.scale / _line_and_nothing(now.contrasts)[1]


def _repeats(squares: Floats) -> Floats:
    """Return the densities of levels that repeat, by their squared differences over the scale's."""
    return np.asarray(_PEAK * (1 + squares / _TAIL) ** (-0.5 * (_TAIL + 1)))


def change_between(now: LineLevels, before: NDArray[Any]) -> Change:
    """Return how levels have changed, by expectation and maximisation; arguments of `repeat_ratio`.

    Before anything is known, each share counts half a bin (Jeffreys 1946), of which the one that
    repeats itself differs by 1 dB.
    """
    steps = np.asarray(now.levels - before, np.float64)
    both = np.isfinite(steps)
    if not both.any():
        return ALL_NEW
    densities, squares = _line_and_nothing(now.contrasts[both]), steps[both] ** 2
    shares, variance = np.full(3, 1 / 3), float(np.median(squares)) + 1 / len(squares)
    for _ in range(_ROUNDS):
        same = _repeats(squares / variance) / math.sqrt(variance)
        parts = shares[:, np.newaxis] * [*densities, same]
        parts /= parts.sum(axis=0)
        totals = 0.5 + parts.sum(axis=1)
        shares, share = totals / totals.sum(), shares[2]
        weights = parts[2] * (_TAIL + 1) / (_TAIL + squares / variance)
        variance = (0.5 + float(weights @ squares)) / float(totals[2])
        if abs(shares[2] - share) < _SETTLED:
            break
    return Change(1 - float(shares[2]), math.sqrt(variance))


@njit(cache=True, nogil=True, error_model="numpy")
def best_stretches(evidence: Any) -> Any:  # pragma: no cover - compiled
    """Return the first and last bin of the stretch of each row with the largest sum, and the sum.

    The last one is below the first where no bin is evidence for a line (Kadane's algorithm).
    """
    rows = len(evidence)
    firsts, lasts, sums = np.zeros(rows, np.int64), np.full(rows, -1), np.zeros(rows)
    for n in range(rows):
        start, total = 0, 0.0
        for b in range(evidence.shape[1]):
            if total <= 0:
                start, total = b, 0.0
            total += evidence[n, b]
            if total > sums[n]:
                firsts[n], lasts[n], sums[n] = start, b, total
    return firsts, lasts, sums


@np.errstate(invalid="ignore")
def stretches(contrasts: NDArray[Any]) -> Any:
    """Return `best_stretches` by the `log_ratio`; what is not seen is weak evidence against it."""
    return best_stretches(np.nan_to_num(log_ratio(contrasts), nan=-0.5))
