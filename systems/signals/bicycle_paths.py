"""Deflections of many paths of the bicycle model at once (Carriere 2016, eqs. 3 and 4)."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numba import njit

from sonoservo.systems.signals.requirements import require


def require_rising(rotations: Sequence[float]) -> None:
    """Raise ValueError unless the depths of rotation, in m, are above zero and ascending."""
    rising = all(a < b for a, b in pairwise([0.0, *rotations]))
    require(rising, "rotations", list(rotations), "depths in m above 0, in ascending order")


@njit(cache=True, error_model="numpy", nogil=True)
def deflections(parameters, depths, rotations):  # type: ignore[no-untyped-def]
    """Return the (n, m) deflections u in m of n paths at m ascending depths in m; NaN past a turn.

    Each path has a row of curvature 1 / R in 1/m and sin(theta_0). At the ascending depths of the
    rotations the curvature changes sign. Below zero the first arc is continued backwards.
    """
    u = np.empty((len(parameters), len(depths)))
    for i in range(len(parameters)):
        curvature, sine = parameters[i]
        u_turn = 0.0
        v_turn = 0.0
        cosine = np.sqrt(1 - sine * sine)
        turn = 0
        for j in range(len(depths)):
            while turn < len(rotations) and depths[j] > rotations[turn]:
                u_turn, sine, cosine = _go(
                    u_turn, sine, cosine, curvature, rotations[turn] - v_turn
                )
                v_turn = rotations[turn]
                curvature = -curvature
                turn += 1
            u[i, j], _, _ = _go(u_turn, sine, cosine, curvature, depths[j] - v_turn)
    return u


@njit(cache=True, error_model="numpy", nogil=True)
def _go(u, sine, cosine, curvature, v):  # type: ignore[no-untyped-def]
    """Return deflection, sine and cosine of theta on an arc after a further depth v.

    sin(theta) grows by v / R, and cos(theta) - cos(theta') = (sin^2 - sin'^2) / -(cos + cos'), in
    which an arc of small curvature loses no digits.
    """
    further = sine + curvature * v
    squared = 1 - further * further
    cosine_further = np.sqrt(squared) if squared > 0 else np.nan
    return u + v * (sine + further) / (cosine + cosine_further), further, cosine_further
