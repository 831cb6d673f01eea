"""Selection of the scatterer tile's blocks that a frame meets, and of scatterers in a block."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.options import OPTIONS


@njit(**OPTIONS)
def frame_blocks(X_FT, box, block_size, depth, half_angle, thickness, rays):  # type: ignore[no-untyped-def]
    """Return the first and last block (exclusive) along T's axes that a frame can meet."""
    sine = np.sin(min(half_angle, np.pi / 2))
    cosine = np.cos(min(half_angle, np.pi / 2))
    nearest = rays.array_radius * cosine - rays.centre_offset
    furthest = depth + rays.array_radius - rays.centre_offset
    middle = (0.0, (nearest + furthest) / 2, 0.0)
    half = ((depth + rays.array_radius) * sine, (furthest - nearest) / 2, thickness)
    first = np.empty(3, np.int64)
    last = np.empty(3, np.int64)
    for axis in range(3):
        centre = 0.0
        extent = 0.0
        for other in range(3):
            centre += X_FT[other, axis] * (middle[other] - X_FT[other, 3])
            extent += abs(X_FT[other, axis]) * half[other]
        first[axis] = np.int64(np.floor(max(centre - extent, box[0, axis]) / block_size))
        last[axis] = np.int64(np.ceil(min(centre + extent, box[1, axis]) / block_size))
    return first, last


@njit(**OPTIONS)
def count_below(ranks, start, end, limit):  # type: ignore[no-untyped-def]
    """Return the number of sorted ranks from start to end that are below a limit."""
    first = start
    while first < end:
        middle = (first + end) // 2
        if ranks[middle] < limit:
            first = middle + 1
        else:
            end = middle
    return first - start
