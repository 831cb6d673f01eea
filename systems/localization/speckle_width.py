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

_BLOCKS_ACROSS, _BLOCKS_DEEP = 5, 8
"""Largest numbers of blocks along X and Z, and along the depth."""

_LAGS = 8
"""Largest distance between two voxels that are compared, in voxels."""

_STRIDE = 2
"""Distance between the pairs of voxels that are compared, along X and Y, in voxels."""

_SEEN, _DEVIATIONS = 0.9, (3.0, 7.5)
"""Share of a block that must be seen, and limits of the standard deviation of its levels in dB.
That of fully developed speckle is 5.6 dB; across a border or the edge of a shadow it is larger."""

_ALIKE = 0.5
"""Squared correlation of the echoes from which the width follows: that at a neighbouring voxel
would depend on the interpolation, and a small one on chance."""

_WIDEST = 2.0
"""Largest width, relative to the median over all depths. In a shadow nothing but a ramp is left."""

_LEAST_BLOCKS = 5
"""Number of blocks without which a depth has no widths."""

_SQUARED = np.linspace(0.0, 1.0, 513)
_DILOGARITHM = spence(1 - _SQUARED) / (np.pi**2 / 6)
"""Correlation of the logarithms of two intensities with exponential distributions, by the squared
correlation of the echoes: Li2(rho^2) / Li2(1)."""


@njit(cache=True, nogil=True)
def _correlations(  # pragma: no cover - compiled
    levels: Any, starts: Any, size: Any, lags: int, share: float, least: float, most: float
) -> Any:
    """Return the (b, 3, lags) correlations of a block's levels with themselves, NaN if unusable."""
    result = np.full((len(starts), 3, lags), np.nan)
    step = np.eye(3, dtype=np.int64)
    for b in range(len(starts)):
        x, y, z = starts[b]
        total, squares, seen = 0.0, 0.0, 0
        for i in range(x, x + size[0]):
            for j in range(y, y + size[1]):
                for k in range(z, z + size[2]):
                    level = float(levels[i, j, k])
                    if level > 0:
                        total += level
                        squares += level * level
                        seen += 1
        if seen < share * size[0] * size[1] * size[2]:
            continue
        mean = total / seen
        variance = squares / seen - mean * mean
        if not least * least < variance < most * most:
            continue
        for axis in range(3):
            for lag in range(1, min(lags, size[axis] // 2) + 1):
                a, c, d = lag * step[axis]
                products, pairs = 0.0, 0
                for i in range(x, x + size[0] - a, _STRIDE):
                    for j in range(y, y + size[1] - c, _STRIDE):
                        for k in range(z, z + size[2] - d):
                            one, other = levels[i, j, k], levels[i + a, j + c, k + d]
                            if one > 0 and other > 0:
                                products += (one - mean) * (other - mean)
                                pairs += 1
                if pairs:
                    result[b, axis, lag - 1] = products / pairs / variance
    return result


def speckle_spread(volume: Volume) -> PointSpread | None:
    """Measure the widths of a point's echo from the speckle of a volume; None without speckle.

    Echoes of many scatterers within a point's echo are complex Gaussian. Their correlation over a
    distance d is rho = exp(-d^2 / (4 sigma^2)), if a point's amplitude is a Gaussian of standard
    deviation sigma, and that of the logarithms of their intensities is Li2(rho^2) / Li2(1), with
    the dilogarithm Li2. The logarithm is what an image shows, and bright structures hardly weigh in
    it. At each depth the median over blocks is taken.

    Parameters
    ----------
    volume
        Volume whose grid's Y axis is the depth.

    Returns
    -------
    Widths by y in P, along X (lateral), Z (elevation) and Y (axial). They contain the blur by the
    interpolation onto the grid.
    """
    shape = np.array(volume.intensities.shape)
    size = np.minimum(np.maximum(np.round(_BLOCK / volume.spacing).astype(int), 4), shape)
    most = np.array([_BLOCKS_ACROSS, _BLOCKS_DEEP, _BLOCKS_ACROSS])
    counts = np.clip(shape // size, 1, most)
    rows = [
        np.linspace(0, extent - edge, count).astype(int)
        for extent, edge, count in zip(shape, size, counts, strict=True)
    ]
    starts = np.stack(np.meshgrid(*rows, indexing="ij"), axis=-1).reshape(-1, 3)
    limits = np.divide(_DEVIATIONS, volume.decibels_per_level)
    correlations = _correlations(volume.intensities, starts, size, _LAGS, _SEEN, *limits)
    depths, widths = [], []
    for row in rows[1]:
        here = correlations[starts[:, 1] == row]
        here = here[np.isfinite(here[:, :, 0]).all(axis=1)]
        if len(here) >= _LEAST_BLOCKS:
            depths.append(volume.origin[1] + volume.spacing[1] * (row + (size[1] - 1) / 2))
            typical = np.median(here, axis=0)
            widths.append([_width(*each) for each in zip(typical, volume.spacing, strict=True)])
    if not depths:
        return None
    limited = np.minimum(widths, _WIDEST * np.median(widths, axis=0))
    lateral, axial, elevation = limited.T
    return PointSpread(np.array(depths), lateral, elevation, axial)


def _width(correlation: NDArray[np.float64], spacing: float) -> float:
    """Return the full width at half maximum from the correlations at 1, 2, ... voxels, in m."""
    known = correlation[np.isfinite(correlation)]
    squared = np.clip(np.interp(known, _DILOGARITHM, _SQUARED), 0.02, 0.98)
    # Each gives sigma by exp(-d^2 / (2 sigma^2)); those on both sides of one half are the surest.
    sigma = spacing * np.arange(1, len(squared) + 1) / np.sqrt(-2 * np.log(squared))
    lag = int(np.argmax(np.append(squared, 0) < _ALIKE))
    if lag in (0, len(squared)):
        return float(FWHM_PER_SIGMA * sigma[min(lag, len(squared) - 1)])
    share = (squared[lag - 1] - _ALIKE) / (squared[lag - 1] - squared[lag])
    return float(FWHM_PER_SIGMA * (sigma[lag - 1] + share * (sigma[lag] - sigma[lag - 1])))
