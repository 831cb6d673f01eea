"""Faces of the field of view, through which a needle may enter (Chatelain 2013, section II-B)."""

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.volume import Volume


def closest_face(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project a position, (3,) in P, in m, on the closest of the six faces of the field of view."""
    faces = _faces(volume, p_P)
    return np.asarray(faces[np.argmin(np.linalg.norm(faces - p_P, axis=1))])


def _faces(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (6, 3) projections: on two lateral and two elevation sides, the probe and the end."""
    if volume.motion is None:
        return _ends_of_what_is_seen(volume, p_P)
    geometry, direction = volume.motion.geometry, volume.motion.direction
    k, j, i = (float(x) for x in geometry.index(p_P, direction))
    frames, lines, samples = (n - 1 for n in geometry.shape)
    return geometry.position(
        [k, k, 0, frames, k, k], [0, lines, j, j, j, j], [i, i, i, i, 0, samples], direction
    )


def _ends_of_what_is_seen(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (6, 3) positions to either side along X, Z and Y of P where what is seen ends."""
    last = np.array(volume.intensities.shape) - 1
    at = np.clip(np.rint((p_P - volume.origin) / volume.spacing), 0, last).astype(int)
    ends = np.repeat(p_P[np.newaxis], 6, axis=0)
    for row, axis in ((0, 0), (2, 2), (4, 1)):
        line = [slice(int(i), int(i) + 1) for i in at]
        line[axis] = slice(None)
        seen = np.flatnonzero(volume.seen[tuple(line)])
        outermost = seen[[0, -1]] if len(seen) else np.array([0, last[axis]])
        ends[row : row + 2, axis] = volume.origin[axis] + volume.spacing[axis] * outermost
    return ends
