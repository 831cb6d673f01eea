"""Axes along a direction, level across it and up from it."""

import numpy as np
from numpy.typing import NDArray


def frame_along(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) rows along a direction, level and across it, and up from it, in T.

    A vertical direction takes +X of T as across.
    """
    along = direction / np.linalg.norm(direction)
    across = np.cross([0.0, 0.0, 1.0], along)
    length = np.linalg.norm(across)
    across = across / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.array([along, across, np.cross(along, across)])
