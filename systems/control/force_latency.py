"""Latency of a force signal, measured by the inertia that the probe shows when it is moved."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import OPTIONS

LONGEST = 0.4
"""Longest latency in s that is measured."""

_MEMORY = 1.0  # Time in s over which a measurement is remembered
# Change of force in N from which on an expected pulse stands out from the sensor's noise.
_FELT = 0.1
# Least share of the measured energy, and largest relative error of the size, of a believed lag.
_EXPLAINED, _ALIKE = 0.8, 0.4


def lags(time_step: float) -> int:
    """Return the number of lags that are tried."""
    return round(LONGEST / time_step) + 1


def next_correlation(
    state: NDArray[np.float64], expected: float, measured: float, time_step: float
) -> tuple[NDArray[np.float64], float]:
    """Return the (4, m) correlation after one more step, and the latency in s, or NaN if unknown.

    `expected` and `measured` are changes since the last step, in N, of the force that moves the
    probe's mass as commanded and of the wrist's force. A lag is believed if it explains nearly all
    of the latter at the expected size; a contact that changes meanwhile leaves the latency unknown.
    """
    # For each of m lags, the state holds the last changes of the expected force, and sums of their
    # products with those of the measured one, of their squares, and of the latter's squares.
    after = np.empty_like(state)
    best, found = _correlate(after, state, expected, measured, 1 - time_step / _MEMORY)
    return after, best * time_step if found else math.nan


@njit(**OPTIONS)
def _correlate(after, state, expected, measured, kept):  # type: ignore[no-untyped-def]
    """Write the next state; return the lag that explains most, and if it is believed."""
    best, most, largest = 0, -1.0, 0.0
    for m in range(state.shape[1]):
        past = expected if m == 0 else state[0, m - 1]
        after[0, m] = past
        after[1, m] = kept * state[1, m] + measured * past
        after[2, m] = kept * state[2, m] + past * past
        after[3, m] = kept * state[3, m] + measured**2
        products, squares, energy = after[1, m], after[2, m], after[3, m]
        largest = max(largest, squares)
        explained = 0.0
        if squares > _FELT**2:
            explained = products**2 / (squares + 1e-12) / energy
        if explained > most:
            best, most = m, explained
    products, squares, energy = after[1, best], after[2, best], after[3, best]
    if not largest > _FELT**2 or not energy > 0:
        return best, False
    alike = abs(products / squares - 1) < _ALIKE
    return best, most > _EXPLAINED and alike and squares > _EXPLAINED * largest
