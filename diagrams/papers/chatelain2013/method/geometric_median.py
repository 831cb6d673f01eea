"""Geometric median: the point with the least sum of distances to given points."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def geometric_median(
    points: ArrayLike, *, tolerance: float = 1e-7, max_trials: int = 200
) -> NDArray[np.float64]:
    """Return the geometric median of points, a robust centre (Chatelain 2013, eq. 2).

    The algorithm is Weiszfeld's iteratively re-weighted least squares, started at the arithmetic
    mean. If an iterate coincides with points of the set, their weight would be infinite. The step
    of Vardi and Zhang (PNAS 97, 2000) then leaves them unless they are the median.

    Parameters
    ----------
    points
        (m, d) points, at least one.
    tolerance
        Length of a step below which the iteration stops, in the points' unit.
    max_trials
        Largest number of steps.

    Returns
    -------
    (d,) geometric median, in the points' unit.

    Raises
    ------
    ValueError
        If the points are not an (m, d) array with m > 0.
    """
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or len(points) == 0:
        raise ValueError(f"points has shape {points.shape}; expected (m, d) with m > 0")
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
