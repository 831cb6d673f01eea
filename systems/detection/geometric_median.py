"""The point with the least sum of distances to given points."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def geometric_median(
    points: ArrayLike, *, tolerance: float = 1e-7, max_trials: int = 200
) -> NDArray[np.float64]:
    """Geometric median of points, a robust centre (Chatelain 2013, eq. 2).

    Weiszfeld's iteratively re-weighted least squares, started at the arithmetic mean. Where an
    iterate meets points of the set, their weight would be infinite: the step of Vardi and Zhang
    (PNAS 97, 2000) leaves the point unless it is the median.

    Parameters
    ----------
    points
        (m, d) points, at least one.
    tolerance
        Stops when a step is shorter; in the points' unit.
    max_trials
        Stops after so many steps.

    Returns
    -------
    (d,) array.

    Raises
    ------
    ValueError
        If there is no point.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or len(points) == 0:
        raise ValueError(f"points has shape {points.shape}; (m, d) with m > 0 is wanted")
    median = points.mean(axis=0)
    for _ in range(max_trials):
        distance = np.linalg.norm(points - median, axis=1)
        apart = distance > tolerance
        if not apart.any():
            return median
        weights = 1 / distance[apart]
        target = weights @ points[apart] / weights.sum()
        here = len(points) - np.count_nonzero(apart)
        if here:
            pull = float(np.linalg.norm(weights @ (points[apart] - median)))
            target = median + max(0.0, 1 - here / max(pull, 1e-300)) * (target - median)
        step = float(np.linalg.norm(target - median))
        median = target
        if step < tolerance:
            break
    return median
