"""Axes along a direction, horizontally across it and upwards from it; distances from a segment."""

import numpy as np
from numpy.typing import NDArray


def frame_along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3, 3) axes in T as rows: along a direction, horizontally across it, and upwards.

    For a vertical direction, +X of T is the second axis.
    """
    x, y, z = direction / np.sqrt(direction @ direction)
    level = np.hypot(x, y)
    c, s = (-y / level, x / level) if level > 1e-9 else (1.0, 0.0)
    return np.array([[x, y, z], [c, s, 0.0], [-z * s, z * c, x * s - y * c]])


def distance_to_segment(
    points: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances in m of (..., 3) points from a straight segment."""
    axis = end - start
    share = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(points - start - share[..., np.newaxis] * axis, axis=-1)
