"""Compiled refinement of a line, and levels along it and beside it."""

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
def refine(  # pragma: no cover - compiled
    intensities: Any, decibels: float, start: Any, stop: Any, u: Any, w: Any, length: float,
    radius: float, share: float, aside: float,
) -> Any:  # fmt: skip
    """Fit a line robustly to the bright centres of its cross-sections.

    Parameters
    ----------
    intensities, decibels
        Intensities, and decibels per unit.
    start, stop, u, w
        (3,) fractional indices of the ends, and differences of index for 1 mm across the line.
    length, radius
        Length of the line and radius of the cross-sections, in m.
    share, aside
        Share of a cross-section's largest amplitude below which a sample does not count, and
        distance from the line at which a cross-section has half the weight, in m.

    Returns
    -------
    (2, 2) displacements of start and stop along u and w, in mm.
    """
    count = max(int(length / 2e-3) + 1, 3)
    half = int(radius * 1e3)
    centres, weights = np.zeros((count, 2)), np.zeros(count)
    levels, places = np.zeros((2 * half + 1) ** 2), np.zeros(((2 * half + 1) ** 2, 2))
    a = np.linspace(0, 1, count)
    for s in range(count):
        x, y, z = start + a[s] * (stop - start)
        n, peak = 0, 0.0
        for p in range(-half, half + 1):
            for q in range(-half, half + 1):
                if p * p + q * q <= half * half:
                    levels[n] = decibels * _level(
                        intensities, x + p * u[0] + q * w[0], y + p * u[1] + q * w[1],
                        z + p * u[2] + q * w[2],
                    )  # fmt: skip
                    places[n, 0], places[n, 1] = p, q
                    peak = max(peak, levels[n])
                    n += 1
        total = 0.0
        for m in range(n):
            if levels[m] > peak + 20 * np.log10(share):
                amplitude = 10 ** ((levels[m] - peak) / 20) - share
                total += amplitude
                centres[s, 0] += amplitude * places[m, 0]
                centres[s, 1] += amplitude * places[m, 1]
        centres[s, 0] /= total
        centres[s, 1] /= total
        weights[s] = min(max(peak - np.median(levels[:n]) - 3, 0.1), 12.0)
    near, ends = np.ones(count), np.zeros((2, 2))
    for _ in range(5):
        v = weights * near
        mean = np.sum(v * a) / np.sum(v)
        spread = max(np.sum(v * (a - mean) ** 2), 1e-12)
        for c in range(2):
            centre = np.sum(v * centres[:, c]) / np.sum(v)
            slope = np.sum(v * (a - mean) * (centres[:, c] - centre)) / spread
            ends[0, c], ends[1, c] = centre - slope * mean, centre + slope * (1 - mean)
        for s in range(count):
            off = centres[s] - ends[0] - a[s] * (ends[1] - ends[0])
            near[s] = 1 / (1 + np.sum(off**2) / (1e3 * aside) ** 2)
    return ends


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
