"""Latency of a force signal, measured by the inertia that the probe shows when it is moved."""

import math

import numpy as np
from numpy.typing import NDArray

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
    """Return the correlation after one more step, and the latency in s, or NaN while unknown.

    The (4, m) state holds, for each of m lags, the last changes of the expected force, and sums of
    their products with those of the measured one, of their squares, and of the squares of the
    latter. `expected` and `measured` are the changes in N, since the step before, of the force that
    moves the probe's mass as commanded and of the wrist's force. A lag is believed if it explains
    nearly all of what is measured, at the size expected, and nearly all of what was expected could
    have been measured by then; a contact that changes meanwhile leaves the latency unknown.
    """
    past = np.concatenate([[expected], state[0, :-1]])
    added = np.stack([measured * past, past * past, np.full_like(past, measured**2)])
    after = np.concatenate([past[np.newaxis], (1 - time_step / _MEMORY) * state[1:] + added])
    _, products, squares, energy = after
    if not squares.max() > _FELT**2 or not energy[0] > 0:
        return after, math.nan
    explained = np.where(squares > _FELT**2, products**2 / (squares + 1e-12) / energy, 0.0)
    best = int(np.argmax(explained))
    found = explained[best] > _EXPLAINED and abs(products[best] / squares[best] - 1) < _ALIKE
    complete = squares[best] > _EXPLAINED * squares.max()
    return after, best * time_step if found and complete else math.nan
