"""Modes of the deflection of a needle whose curvature wanders along its path."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.immutable import Immutable, Shape

Floats = NDArray[np.float64]

_STEP = 1e-3
"""Depth in m over which the wandering curvature counts as constant."""

_SHARE = 0.998
"""Share of the curvature's variance that the modes represent."""


@dataclass(frozen=True, eq=False)
class WanderModes(Immutable):
    """Principal modes of the deflection by a curvature that is a Gaussian process of depth.

    The process has the covariance exp(-d^2 / (4 L^2)) at a distance d, the correlation of white
    noise that was smoothed by a Gaussian of standard deviation L, times a variance. Its principal
    components are integrated twice over depth, with the sign of the bevel. The deflection is then a
    sum of the modes with independent normal coefficients, whose standard deviation is that of the
    curvature. This neglects slopes of second order, which change the deflection by some per cent.
    """

    depths: Annotated[Floats, Shape("g")]
    """Ascending and equidistant depths from zero, in m."""

    deflections: Annotated[Floats, Shape("g", None)]
    """Deflection of each mode at these depths, in m per 1/m of curvature."""

    def __len__(self) -> int:
        return self.deflections.shape[1]

    def at(self, depths: ArrayLike) -> Floats:
        """Return the (m, k) deflections, in m per 1/m of curvature, at (m,) depths in m."""
        last = len(self.depths) - 1
        place = np.clip(np.asarray(depths, dtype=float) / self.depths[1], 0, last)
        below = np.minimum(place.astype(int), last - 1)
        share = (place - below)[:, np.newaxis]
        found: Floats = (1 - share) * self.deflections[below] + share * self.deflections[below + 1]
        return found


def wander_modes(depth: float, rotations: Sequence[float], length: float) -> WanderModes:
    """Return the modes of a wandering curvature of length L down to a depth, both in m."""
    return _wander_modes(depth, tuple(rotations), length)


@lru_cache(maxsize=16)
def _wander_modes(depth: float, rotations: tuple[float, ...], length: float) -> WanderModes:
    count = max(int(np.ceil(depth / _STEP)), 2)
    step = depth / count
    middle = step * (np.arange(count) + 0.5)
    covariance = np.exp(-((middle[:, np.newaxis] - middle) ** 2) / (4 * length**2))
    variance, components = np.linalg.eigh(covariance)
    variance, components = np.maximum(variance[::-1], 0), components[:, ::-1]
    kept = int(np.searchsorted(np.cumsum(variance), _SHARE * count)) + 1
    sign = (-1.0) ** np.searchsorted(rotations, middle)
    curvature = sign[:, np.newaxis] * components[:, :kept] * np.sqrt(variance[:kept])
    slope = np.vstack([np.zeros(kept), np.cumsum(step * curvature, axis=0)])
    rise = 0.5 * step * (slope[1:] + slope[:-1])
    deflections: Floats = np.vstack([np.zeros(kept), np.cumsum(rise, axis=0)])
    depths: Floats = step * np.arange(count + 1, dtype=np.float64)
    return WanderModes(depths, deflections)
