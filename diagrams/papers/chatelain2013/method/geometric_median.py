"""Geometric median: the point with the least sum of distances to given points."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def geometric_median(
    points: ArrayLike, *, tolerance: float = 1e-7, max_trials: int = 200
) -> NDArray[np.float64]:
    """Return the (d,) geometric median of (m, d) points (Chatelain 2013, eq. 2).

    Weiszfeld's iteration starts at their mean and steps beyond a point that it hits (Vardi and
    Zhang 2000). No point raises ValueError.
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
