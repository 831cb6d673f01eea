"""Orthogonal axes along a direction, horizontally across it, and upwards from it."""

import numpy as np
from numpy.typing import NDArray


def frame_along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3, 3) axes in T as rows: along a direction, horizontally across it, and upwards.

    For a vertical direction, +X of T is the second axis.
    """
    along = direction / np.linalg.norm(direction)
    across = np.cross([0.0, 0.0, 1.0], along)
    length = np.linalg.norm(across)
    across = across / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.array([along, across, np.cross(along, across)])
