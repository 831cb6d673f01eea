"""Compiled levels along a line and beside it."""

from typing import Any

import numpy as np
from numba import njit

from sonoservo.systems.sampling.interpolation import flagged, trilinear


@njit(cache=True, nogil=True, error_model="numpy")
def _level(intensities: Any, x: float, y: float, z: float) -> Any:  # pragma: no cover - compiled
    """Return the intensity at fractional indices; 0 outside the grid."""
    nx, ny, nz = intensities.shape
    if 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1:
        return trilinear(intensities, x, y, z)
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _is_seen(seen: Any, x: float, y: float, z: float) -> Any:  # pragma: no cover - compiled
    """Return True if an element around fractional indices was seen."""
    nx, ny, nz = seen.shape
    if 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1:
        return flagged(seen, x, y, z)
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def profile(  # pragma: no cover - compiled
    intensities: Any, seen: Any, points: Any, core: Any, ring: Any, half: int, brighter: float
) -> Any:
    """Return the levels along a line and those of a bright side beside it.

    The brightest of many sides is bright by chance, the more so the fewer its samples.

    Parameters
    ----------
    intensities, seen
        Intensities, and flags of those that were seen.
    points
        (m, 3) fractional indices of points on the line.
    core, ring
        (c, 3) and (rings, sectors, 3) differences of index between a point and the samples.
    half
        Number of points to either side over which a sector's level is averaged.
    brighter
        Share of the sectors seen that are brighter than the one that counts as the side.

    Returns
    -------
    (m,) means of the core, means of that sector where the core is seen, and flags of the points
    where it is.
    """
    m, sectors = len(points), ring.shape[1]
    levels, sides, shown = np.zeros(m), np.zeros(m), np.zeros(m, np.bool_)
    brightest = np.zeros(int(brighter * sectors) + 1)  # means, in descending order
    total, count = np.zeros((m + 1, sectors)), np.zeros((m + 1, sectors))  # up to each point
    for s in range(m):
        x, y, z = points[s]
        for c in range(len(core)):
            a, b, e = x + core[c, 0], y + core[c, 1], z + core[c, 2]
            levels[s] += _level(intensities, a, b, e)
            shown[s] |= _is_seen(seen, a, b, e)
        levels[s] /= len(core)
        for c in range(sectors):
            total[s + 1, c], count[s + 1, c] = total[s, c], count[s, c]
            for t in range(ring.shape[0] if shown[s] else 0):
                a, b, e = x + ring[t, c, 0], y + ring[t, c, 1], z + ring[t, c, 2]
                total[s + 1, c] += _level(intensities, a, b, e)
                count[s + 1, c] += _is_seen(seen, a, b, e)
    for s in range(m):
        first, last = max(s - half, 0), min(s + half + 1, m)
        brightest[:], sides_seen = 0, 0
        for c in range(sectors):
            samples = count[last, c] - count[first, c]
            if samples > half:
                sides_seen += 1
                mean = (total[last, c] - total[first, c]) / samples
                for place in range(len(brightest)):
                    if mean > brightest[place]:
                        mean, brightest[place] = brightest[place], mean
        sides[s] = brightest[int(brighter * sides_seen)]
    return levels, sides, shown
