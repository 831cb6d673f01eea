"""Local optimization of a bent axis as published: Nelder and Mead's simplex on eq. 18."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.tracking.axis import Axis, axis_through

_FIRST_STEP = 0.5e-3
"""Displacement of one coordinate of a control point in the first simplex, in m."""

_TOLERANCE = 5e-6
"""Size of the simplex in m at which the search ends."""


def principal_axis(control_points: NDArray[np.float64]) -> Axis | NotFound:
    """Return the curve through (n, 3) control points over the line fitted to them (Chatelain 2013).

    Fig. 1 and eq. 18: k_0 is the direction of that line; abscissae count from the first point.
    """
    centred = control_points - control_points.mean(axis=0)
    k = np.linalg.svd(centred)[2][0]
    along = control_points[-1] - control_points[0]
    return axis_through(control_points, k if k @ along >= 0 else -k)


def relative_sagitta(control_points: NDArray[np.float64]) -> float:
    """Return the distance of the middle one of (3, 3) control points from the chord, over it."""
    first, middle, last = control_points
    chord = last - first
    length = float(np.linalg.norm(chord))
    if not length > 0:
        return np.inf
    aside = middle - first
    aside = aside - (aside @ chord) * chord / length**2
    return float(np.linalg.norm(aside)) / length


def optimize_locally(
    points: NDArray[np.float64], axis: Axis, *, max_bend: float, max_trials: int = 600
) -> Axis:
    """Optimize a bent axis of order 3 on its (m, 3) inliers, in m, without derivatives.

    The method of Nelder and Mead minimizes the mean distance from the inliers (Chatelain 2013,
    section II-D) over axes whose ratio of sagitta to chord is at most ``max_bend``. The given axis
    is returned if no better one was found.
    """
    a = axis.abscissa(points)
    start = axis.position(np.linspace(a.min(), a.max(), 3))

    def cost(variables: NDArray[np.float64]) -> float:
        control_points = variables.reshape(3, 3)
        if relative_sagitta(control_points) > max_bend:
            return np.inf
        curve = principal_axis(control_points)
        return np.inf if isinstance(curve, NotFound) else float(curve.distance(points).mean())

    simplex = start.ravel() + np.vstack([np.zeros(9), _FIRST_STEP * np.eye(9)])
    best = minimize(
        cost,
        start.ravel(),
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "maxfev": max_trials,
            "xatol": _TOLERANCE,
            "fatol": _TOLERANCE,
        },
    )
    optimized = principal_axis(best.x.reshape(3, 3))
    if isinstance(optimized, NotFound) or not best.fun <= axis.distance(points).mean():
        return axis
    return optimized
