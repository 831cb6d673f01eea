"""Extraction of the surface at which a sampled field is one half, in pieces."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from sonoservo.systems.ultrasound.simulation.structures.surface import Surface

_LEAST_SLOPE = 0.02


def level_surface(
    field: NDArray[np.float32], origin: NDArray[np.float64], spacing: float
) -> Surface:
    """Extract the surface at which a field is 1/2, with normals towards smaller values.

    Every cell between eight samples in which the field crosses 1/2 gives one piece. Within a cell,
    the field is taken as linear: f0 + g . x, with x from 0 to 1. The area of its level set is the
    derivative of the volume below the level (Scardovelli and Zaleski 2000),

        A = |g| / (2 g1 g2 g3) sum over corners s of (-1)^|s| max(c - g . s, 0)^2

    with |g_i| for g_i and c the level above the lowest corner. The areas of a plane's pieces add
    up to the plane's.

    Parameters
    ----------
    field
        (nx, ny, nz) samples of the field.
    origin, spacing
        (3,) position of the first sample, and distance between samples, in m.
    """
    inside = field > 0.5
    box = find_objects(inside.astype(np.uint8))
    if not box or box[0] is None:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    first = np.array([max(each.start - 2, 0) for each in box[0]])
    part = tuple(
        slice(low, min(each.stop + 2, size))
        for low, each, size in zip(first, box[0], field.shape, strict=True)
    )
    field, inside = field[part], inside[part]
    cells = np.argwhere(_crossed(inside))
    corners = np.array([field[tuple((cells + s).T)] for s in np.ndindex(2, 2, 2)], dtype=np.float64)
    signs = 2 * np.array(list(np.ndindex(2, 2, 2))) - 1
    slope = corners.T @ signs / 4
    middle = corners.mean(axis=0)
    steepness = np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
    normals = -slope / steepness[:, np.newaxis]
    areas = spacing**2 * _section(np.abs(slope) / steepness[:, None], (0.5 - middle) / steepness)
    shift = np.clip((middle - 0.5) / steepness, -1, 1)[:, np.newaxis] * normals
    points = origin + spacing * (cells + first + 0.5 + shift)
    kept = areas > 0
    return Surface(points[kept], normals[kept], areas[kept])


def _crossed(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the cells whose corners are not all alike."""
    some, every = inside, inside
    for axis in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        some = some[tuple(low)] | some[tuple(high)]
        every = every[tuple(low)] & every[tuple(high)]
    return some & ~every


def _section(normal: NDArray[np.float64], offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the areas in which planes with (n, 3) unit normals >= 0 cut the unit cube.

    ``offset`` are the (n,) distances of the planes from the cube's centre along the normals.
    """
    g = np.maximum(normal, _LEAST_SLOPE)
    level = offset + g.sum(axis=1) / 2
    total = np.zeros(len(g))
    for corner in np.ndindex(2, 2, 2):
        total += (-1) ** sum(corner) * np.maximum(level - g @ np.array(corner), 0) ** 2
    return np.maximum(np.linalg.norm(g, axis=1) * total / (2 * g.prod(axis=1)), 0)
