"""Cells of a volume: their levels above the surroundings, and how the tissue moved between two."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from sonoservo.systems.sampling.interpolation import trilinear
from sonoservo.systems.sampling.workers import by_parts
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_CELL, _MOST_CELLS = 1.5e-3, 50_000
"""Smallest edge length of a cell, in m: no wider than the beam. Beyond a number of cells, larger
ones are used; a line that fills a part of them still brightens their power."""

_AROUND = 13e-3
"""Edge length in m of the cube over which the level around a cell is averaged."""

_DARKEST, _BRIGHTEST = -6.0, 14.0
"""Limits of a cell's level above its surroundings, in dB."""

_SHADOWED, _LIT = np.float32(7.0), 0.9
"""How far in dB the level lies below that at its depth where no sound arrives, and the share of the
levels at a depth that lie below the one that stands for it."""

_NO_LEVEL = -1e3
"""Level in dB at a depth of which nothing is seen."""

_UNLIKE = 3.0
"""Difference in dB of two cells' levels at which they tell half as much about a shift: something
that appears or vanishes between two volumes does not move."""

_STEPS, _CONVERGED = 8, 0.02
"""Largest number of steps of the search for a shift, and length of a step that ends it, in cells.
"""


@njit(cache=True, nogil=True)
def _cell_levels(  # pragma: no cover - compiled
    intensities: Any, powers: Any, seen: Any, bx: int, by: int, bz: int
) -> Any:
    """Return the mean power of each block of voxels in dB, and whether most of it was seen.

    ``powers`` are those of the grey levels, relative to the lowest.
    """
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
                            if seen[i, j, k]:
                                total += powers[int(min(intensities[i, j, k], 255) + 0.5)]
                                count += 1
                if 2 * count >= bx * by * bz:
                    means[p, q, r] = 10 * math.log10(total / count)
                    shown[p, q, r] = True
    return means, shown


@dataclass(frozen=True, eq=False)
class Cells:
    """(i, j, k) levels of a volume's cells, in dB above the mean around each; 0 where unseen."""

    levels: NDArray[np.float32]
    seen: NDArray[np.bool_]
    lit: NDArray[np.bool_]
    """Flags of the cells that are seen and not shadowed: by air at the probe's face, or bone."""
    darkest: NDArray[np.float32]
    """(j,) levels in dB at the depths of the cells below which no sound arrives."""
    origin: Floats
    """(3,) position in P of the first cell's centre, in m."""
    edges: Floats

    def darkest_at(self, depth: Floats) -> Floats:
        """Return the levels in dB at depths in P in m below which no sound arrives."""
        at = (depth - self.origin[1]) / self.edges[1]
        return np.asarray(np.interp(at, np.arange(len(self.darkest)), self.darkest))


def cells_of(volume: Volume) -> Cells:
    """Return the cells of a volume."""
    edge = max(_CELL, float(np.prod(volume.upper - volume.origin) / _MOST_CELLS) ** (1 / 3))
    size = np.maximum(1, np.round(edge / volume.spacing)).astype(int)
    edges = size * volume.spacing
    powers = 10 ** (0.1 * volume.decibels_per_level * np.arange(256))

    def levels_of(part: slice) -> Any:
        rows = slice(size[0] * part.start, size[0] * part.stop)
        return _cell_levels(volume.intensities[rows], powers, volume.seen[rows], *size)

    parts = by_parts(levels_of, len(volume.intensities) // int(size[0]))
    means, seen = (np.concatenate(each) for each in zip(*parts, strict=True))
    window = np.maximum(3, np.round(_AROUND / edges)).astype(int)
    share = uniform_filter(seen.astype(np.float32), window, mode="constant")
    around = uniform_filter(means, window, mode="constant") / np.maximum(share, np.float32(0.05))
    levels = np.where(seen, np.clip(means - around, _DARKEST, _BRIGHTEST), np.float32(0))
    by_depth = np.where(seen, around, np.float32(-np.inf)).swapaxes(0, 1)
    ranked = np.sort(by_depth.reshape(len(by_depth), -1), axis=1)
    brighter = ((1 - _LIT) * seen.sum(axis=(0, 2))).astype(int)
    darkest = ranked[np.arange(len(ranked)), ranked.shape[1] - 1 - brighter] - _SHADOWED
    darkest = np.maximum(darkest, np.float32(_NO_LEVEL))
    lit = seen & (around > darkest[:, np.newaxis])
    return Cells(levels, seen, lit, darkest, volume.position(0.5 * size - 0.5), edges)


@njit(cache=True, nogil=True, error_model="numpy")
def _shift_equations(  # pragma: no cover - compiled
    now: Any, now_seen: Any, before: Any, before_seen: Any, M: Any, offset: Any, same: Any
) -> Any:
    """Return the normal equations of the shift of an image, and what the two have in common there.

    That is the products of their gradients, their correlation, and the variance of the levels now.
    ``M`` and ``offset`` take indices of the cells now to those before that show the same tissue,
    and ``same`` (2, 3) factors and offsets to those at the same place in the image. A cell belongs
    to either. Every second cell counts.
    """
    nx, ny, nz = before.shape
    H, g, common, back = np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), np.linalg.inv(M)
    gradient, own = np.zeros(3), np.zeros(3)
    count = 0
    both, here, there = 0.0, 1e-6, 1e-6
    for i in range(1, now.shape[0] - 1, 2):
        for j in range(1, now.shape[1] - 1, 2):
            for k in range(1, now.shape[2] - 1, 2):
                if not now_seen[i, j, k]:
                    continue
                x = M[0, 0] * i + M[0, 1] * j + M[0, 2] * k + offset[0]
                y = M[1, 0] * i + M[1, 1] * j + M[1, 2] * k + offset[1]
                z = M[2, 0] * i + M[2, 1] * j + M[2, 2] * k + offset[2]
                if not (1 <= x <= nx - 2 and 1 <= y <= ny - 2 and 1 <= z <= nz - 2):
                    continue
                p, q, r = int(x + 0.5), int(y + 0.5), int(z + 0.5)
                if not before_seen[p, q, r]:
                    continue
                level = trilinear(before, x, y, z)
                both += level * now[i, j, k]
                here += now[i, j, k] ** 2
                # Interpolation averages speckle, so between cells any image would be more alike.
                there += before[p, q, r] ** 2
                error = now[i, j, k] - level
                gradient[0] = trilinear(before, x + 1, y, z) - trilinear(before, x - 1, y, z)
                gradient[1] = trilinear(before, x, y + 1, z) - trilinear(before, x, y - 1, z)
                gradient[2] = trilinear(before, x, y, z + 1) - trilinear(before, x, y, z - 1)
                own[0] = now[i + 1, j, k] - now[i - 1, j, k]
                own[1] = now[i, j + 1, k] - now[i, j - 1, k]
                own[2] = now[i, j, k + 1] - now[i, j, k - 1]
                rides = 0.0
                x = same[0, 0] * i + same[1, 0]
                y = same[0, 1] * j + same[1, 1]
                z = same[0, 2] * k + same[1, 2]
                if 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1:
                    away = now[i, j, k] - trilinear(before, x, y, z)
                    rides = 1 / (1 + (away / _UNLIKE) ** 2)
                rests = 1 / (1 + (error / _UNLIKE) ** 2)
                weight = rests**2 / (rests + rides)
                for a in range(3):
                    g[a] += 0.5 * weight * gradient[a] * error
                    turned = 0.0
                    for b in range(3):
                        H[a, b] += 0.25 * weight * gradient[a] * gradient[b]
                        turned += back[b, a] * own[b]
                    for b in range(3):
                        common[a, b] += 0.25 * weight * turned * gradient[b]
                count += 1
    return H, g, common, both / math.sqrt(here * there), here / max(count, 1), count


def _told(common: Floats, alike: float, variance: float, count: int, tried: int) -> Floats:
    """Return the (3, 3) information about a shift, by what two images have in common there.

    Only the gradients that both have tell about it: those of other speckle do not (``common``).
    Images are Gaussian with a ``variance``; ``count`` cells are compared at each of the shifts
    ``tried``, of which the best one is alike by chance if the images have nothing in common.
    """
    alike = min(max(alike, 0.0), 1 - 1e-3)
    chance = tried * math.exp(-0.5 * count * alike**2)
    lengths, axes = np.linalg.eigh(0.5 * (common + common.T))
    shared = (axes * np.maximum(lengths, 0.0)) @ axes.T
    return np.asarray(alike * shared / ((1 - alike**2) * variance * (1 + chance)))


def tissue_shift(
    now: Cells, before: Cells, X_BN: Floats, starts: list[Floats]
) -> tuple[Floats, Floats]:
    """Return the (3,) shift of the tissue in m, in P before, and (3, 3) information about it.

    What lies at p now lay at ``X_BN`` p + shift. Of the results from all ``starts``, the one with
    the largest correlation counts (Lucas and Kanade 1981, with the weights of a Cauchy
    distribution). A search that does not converge tells nothing; if none does, the shift is zero
    without any information.
    """
    # Breath, a late pose and a wrong calibration shift all tissue alike. Reverberation and the
    # borders of shadows ride along with the probe.
    M = X_BN[:3, :3] * now.edges / before.edges[:, np.newaxis]
    offset = (X_BN[:3, :3] @ now.origin + X_BN[:3, 3] - before.origin) / before.edges
    same = np.stack([now.edges / before.edges, (now.origin - before.origin) / before.edges])
    best, information, most_alike = np.zeros(3), np.zeros((3, 3)), -1.0
    for start in starts:
        found = _search(now, before, M, offset, same, start / before.edges)
        if found is None:
            continue
        shift, common, alike, variance, count = found
        if alike > most_alike:
            best, most_alike = shift * before.edges, alike
            told = _told(common, alike, variance, count, len(starts))
            information = told / np.outer(before.edges, before.edges)
    return best, information


def _search(
    now: Cells, before: Cells, M: Floats, offset: Floats, same: Floats, shift: Floats
) -> tuple[Floats, Floats, float, float, int] | None:
    """Return the shift in cells that is found from a first one, and what is in common there."""
    for _ in range(_STEPS):
        H, g, *found = _shift_equations(
            now.levels, now.lit, before.levels, before.lit, M, offset + shift, same
        )
        if found[-1] < 200 or not np.trace(H) > 0:
            return None
        step = np.clip(np.linalg.solve(H + 1e-3 * np.trace(H) * np.eye(3), g), -1, 1)
        if np.abs(step).max() < _CONVERGED:
            return shift, *found
        shift = shift + step
    return None
