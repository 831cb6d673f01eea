"""Widths of the blur of an image, measured from its own speckle."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import spence

from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA, PointSpread
from sonoservo.systems.signals.volume import Volume

_BLOCK = 8e-3
"""Edge length of the blocks in which speckle is measured, in m."""

_MOST_BLOCKS, _MOST_DEPTHS = 16, 8
"""Largest numbers of blocks at a depth, and of depths."""

_LAGS = 8
"""Number of distances up to half a block at which voxels are compared."""

_STRIDE = 2
"""Distance between the pairs of voxels that are compared, along X and Y, in voxels."""

_SEEN, _DEVIATIONS = 0.9, (1.0, 7.5)
"""Share of a block that must be seen, and limits of the standard deviation of its levels in dB.
That of fully developed speckle is 5.6 dB. Compounding and interpolation make it smaller; across a
border or the edge of a shadow it is larger."""

_ALIKE = 0.5
"""Squared correlation of the echoes from which the width follows: that at a neighbouring voxel
would depend on the interpolation, and a small one on chance."""

_WIDEST = 2.0
"""Largest width, relative to the median over all depths: a shadow shows a ramp and no speckle."""

_LEAST_BLOCKS = 5
"""Number of blocks without which a depth has no widths."""

_SQUARED = np.linspace(0.0, 1.0, 513)
_DILOGARITHM = spence(1 - _SQUARED) / (np.pi**2 / 6)
"""Correlation of the logarithms of two intensities with exponential distributions, by the squared
correlation of the echoes: Li2(rho^2) / Li2(1)."""


@njit(cache=True, nogil=True)
def _correlations(  # pragma: no cover - compiled
    levels: Any, shown: Any, floor: float, starts: Any, size: Any, lags: Any, share: float,
    least: float, most: float,
) -> Any:  # fmt: skip
    """Return the (b, 3, lags) correlations of a block's levels with themselves, NaN if unusable.

    The (3, lags) distances are in voxels, and ``floor`` is the lowest level.
    """
    result = np.full((len(starts), *lags.shape), np.nan)
    step = np.eye(3, dtype=np.int64)
    for b in range(len(starts)):
        x, y, z = starts[b]
        total, squares, seen, bright = 0.0, 0.0, 0, 0
        for i in range(x, x + size[0]):
            for j in range(y, y + size[1]):
                for k in range(z, z + size[2]):
                    level = float(levels[i, j, k])
                    if shown[i, j, k]:
                        total += level
                        squares += level * level
                        seen += 1
                        bright += level > floor
        # Where most is below the display's range, what is left is no speckle.
        if seen < share * size[0] * size[1] * size[2] or 2 * bright < seen:
            continue
        mean = total / seen
        variance = squares / seen - mean * mean
        if not least * least < variance < most * most:
            continue
        for axis in range(3):
            for m in range(lags.shape[1]):
                a, c, d = lags[axis, m] * step[axis]
                products, pairs = 0.0, 0
                for i in range(x, x + size[0] - a, _STRIDE):
                    for j in range(y, y + size[1] - c, _STRIDE):
                        for k in range(z, z + size[2] - d):
                            if shown[i, j, k] and shown[i + a, j + c, k + d]:
                                one, other = levels[i, j, k], levels[i + a, j + c, k + d]
                                products += (one - mean) * (other - mean)
                                pairs += 1
                if pairs:
                    result[b, axis, m] = products / pairs / variance
    return result


def speckle_spread(volume: Volume) -> PointSpread | None:
    """Measure the widths of a point's echo by y in P from the speckle; None without speckle.

    They contain the blur by the interpolation onto the grid, whose Y axis must be the depth.
    """
    # Echoes of many scatterers within a point's echo are complex Gaussian. If a point's amplitude
    # is a Gaussian of standard deviation sigma, their correlation over a distance d is
    # rho = exp(-d^2 / (4 sigma^2)), and that of the logarithms of their intensities is
    # Li2(rho^2) / Li2(1), with the dilogarithm Li2. An image shows the logarithm, in which bright
    # structures hardly weigh. At each depth the median over blocks is taken.
    shape = np.array(volume.intensities.shape)
    size = np.minimum(np.maximum(np.round(_BLOCK / volume.spacing).astype(int), 4), shape)
    lags = np.linspace(1, np.maximum(size // 2, 1), _LAGS, axis=1).round().astype(int)
    limits = np.divide(_DEVIATIONS, volume.decibels_per_level)
    floor = float(volume.intensities[volume.seen].min(initial=255))
    depths, widths = [], []
    for row in np.unique(np.linspace(0, shape[1] - size[1], _MOST_DEPTHS).astype(int)):
        starts = _seen_blocks(volume.seen, int(row), size)
        here = _correlations(
            volume.intensities, volume.seen, floor, starts, size, lags, _SEEN, *limits
        )
        here = here[np.isfinite(here).all(axis=(1, 2))]
        if len(here) < _LEAST_BLOCKS:
            continue
        typical = np.median(here, axis=0)
        each = [_width(*axis) for axis in zip(typical, lags, volume.spacing, strict=True)]
        if np.isfinite(each).all():
            depths.append(volume.origin[1] + volume.spacing[1] * (row + (size[1] - 1) / 2))
            widths.append(each)
    if not depths:
        return None
    limited = np.minimum(widths, _WIDEST * np.median(widths, axis=0))
    lateral, axial, elevation = limited.T
    return PointSpread(np.array(depths), lateral, elevation, axial)


def _seen_blocks(shown: NDArray[np.bool_], row: int, size: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (b, 3) first voxels of blocks at a depth that seem to lie in the field of view."""
    (nx, _, nz), (dx, dy, dz) = shown.shape, size
    columns = (np.arange(0, n - d + 1, max(d // 2, 1)) for n, d in ((nx, dx), (nz, dz)))
    x, z = (each.ravel() for each in np.meshgrid(*columns))
    seen = np.ones(len(x), bool)
    for a in (0, dx - 1):
        for c in (0, dy - 1):
            for d in (0, dz - 1):
                seen &= shown[x + a, row + c, z + d]
    starts = np.stack([x, np.full_like(x, row), z], axis=1)[seen]
    few = np.linspace(0, len(starts) - 1, min(len(starts), _MOST_BLOCKS)).astype(int)
    return starts[few]


def _width(correlation: NDArray[np.float64], lags: NDArray[np.int64], spacing: float) -> float:
    """Return the full width at half maximum in m, from correlations at distances in voxels.

    It is NaN if they do not fall below one half, as there is more than speckle.
    """
    squared = np.clip(np.interp(correlation, _DILOGARITHM, _SQUARED), 0.02, 0.98)
    if squared.min() >= _ALIKE:
        return np.nan
    # Each gives sigma by exp(-d^2 / (2 sigma^2)); those on both sides of one half are the surest.
    sigma = spacing * lags / np.sqrt(-2 * np.log(squared))
    below = int(np.argmax(squared < _ALIKE))
    if below == 0:
        return float(FWHM_PER_SIGMA * sigma[0])
    share = (squared[below - 1] - _ALIKE) / (squared[below - 1] - squared[below])
    return float(FWHM_PER_SIGMA * (sigma[below - 1] + share * (sigma[below] - sigma[below - 1])))
