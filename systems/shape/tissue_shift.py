"""Modes of a shift of the tissue that is correlated from slice to slice, as by breathing."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.curvature_wander import WanderModes

_SHARE = 0.99
"""Share of the shift's variance that the modes represent."""


@lru_cache(maxsize=16)
def shift_modes(depth: float, length: float) -> WanderModes:
    """Return the principal modes of a shift with the covariance exp(-d^2 / (2 length^2)).

    Down to ``depth`` in m, their sum with independent normal coefficients of standard deviation s
    is a shift of standard deviation s.
    """
    depths = np.linspace(0, depth, max(int(np.ceil(3 * depth / length)), 2) + 1)
    apart = (depths[:, np.newaxis] - depths) / length
    values, vectors = np.linalg.eigh(np.exp(-0.5 * apart**2))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    number = int(np.searchsorted(np.cumsum(values), _SHARE * values.sum())) + 1
    modes: NDArray[np.float64] = vectors[:, :number] * np.sqrt(values[:number])
    return WanderModes(depths, modes)
