"""Field of view of an image, judged by the image alone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

_FAINTEST_CUT = 1.0
"""Level in dB up to which a cut makes no difference."""


def darkest(intensities: NDArray[Any]) -> float:
    """Return the darkest level of an image that is not black; infinity if all of it is."""
    shown = intensities[intensities > 0]
    return float(shown.min()) if shown.size else np.inf


def cut_level(darkest_level: float, decibels_per_level: float) -> float:
    """Return the level below which an image shows nothing; 0 if it shows all.

    If the darkest level other than black is far above black, dark levels were removed. Black then
    tells only that something is darker than that.
    """
    cut = np.isfinite(darkest_level) and darkest_level * decibels_per_level > _FAINTEST_CUT
    return darkest_level if cut else 0.0


def seen_hull(intensities: NDArray[Any]) -> NDArray[np.bool_]:
    """Return (nx, ny, nz) flags of the voxels seen by an image of unknown field of view.

    These are the convex hull of what is not black, as dark cysts, shadows and water lie in it. A
    probe's face bulges into the body and dents the hull. If most of the hull echoes, what is dark
    before the first echo along Y (the direction of sound), or beside the outermost echoes along X
    and Z, counts as not seen. If little of it echoes, darkness tells nothing. All of a black image
    counts as seen.
    """
    bright = intensities > 0
    rows = bright.any(axis=0)
    if not rows.any():
        return np.ones_like(bright)
    lowest, highest = bright.argmax(axis=0), bright.shape[0] - 1 - bright[::-1].argmax(axis=0)
    j, k = np.nonzero(rows)
    ends = np.concatenate([np.stack([x[j, k], j, k], axis=1) for x in (lowest, highest)])
    seen = _convex(ends, bright.shape) | bright
    if 2 * np.count_nonzero(bright) > np.count_nonzero(seen):
        seen &= np.logical_or.accumulate(bright, axis=1)
        for axis in (0, 2):
            seen &= np.logical_or.accumulate(bright, axis=axis)
            seen &= np.flip(np.logical_or.accumulate(np.flip(bright, axis), axis=axis), axis)
    return seen


def _convex(points: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return flags of the elements of a grid in the convex hull of (m, 3) of its elements."""
    box = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.column_stack([box, -(box @ points.T).max(axis=1)])
    try:
        hull = np.unique(ConvexHull(points).equations.round(9), axis=0)
        faces = np.concatenate([faces, hull])
    except QhullError:  # a plane, a line or a point
        pass
    x, y, z = (np.arange(n) for n in shape)
    first, last = np.full(shape[1:], -np.inf), np.full(shape[1:], np.inf)
    for a, b, c, d in faces:
        edge = 1e-6 - (b * y[:, np.newaxis] + c * z + d)
        if a > 1e-9:
            np.minimum(last, edge / a, out=last)
        elif a < -1e-9:
            np.maximum(first, edge / a, out=first)
        else:
            first[edge < 0] = np.inf
    x = x[:, np.newaxis, np.newaxis]
    return np.asarray((x >= first) & (x <= last))
