"""Selection of the scatterer tile's blocks that a frame meets, and of scatterers in a block."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.kernels import INNER


@njit(**INNER)
def frame_blocks(  # type: ignore[no-untyped-def]
    first, last, X_FT, box, block_size, depth, half_angle, thickness, margin, rays
):
    """Write the (3,) first and last block (exclusive) along T's axes that a frame can meet.

    The slab has a half width in elevation, its thickness, and is enlarged by a margin in the
    frame's plane; lengths in m, the largest angle of a line to the middle one in rad.
    """
    sine = np.sin(min(half_angle, np.pi / 2))
    cosine = np.cos(min(half_angle, np.pi / 2))
    nearest = rays.array_radius * cosine - rays.centre_offset - margin
    furthest = depth + rays.array_radius - rays.centre_offset + margin
    middle = (0.0, (nearest + furthest) / 2, 0.0)
    half = ((depth + rays.array_radius) * sine + margin, (furthest - nearest) / 2, thickness)
    for axis in range(3):
        centre = 0.0
        extent = 0.0
        for other in range(3):
            centre += X_FT[other, axis] * (middle[other] - X_FT[other, 3])
            extent += abs(X_FT[other, axis]) * half[other]
        first[axis] = np.int64(np.floor(max(centre - extent, box[0, axis]) / block_size))
        last[axis] = np.int64(np.ceil(min(centre + extent, box[1, axis]) / block_size))


@njit(**INNER)
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


@njit(**INNER)
def keep_between(chosen, count, xs, ys, zs, low, high):  # type: ignore[no-untyped-def]
    """Remove the chosen scatterers that lie outside a box; return the number left."""
    left = 0
    for number in range(count):
        i = chosen[number]
        chosen[left] = i
        left += (
            (xs[i] > low[0])
            & (xs[i] < high[0])
            & (ys[i] > low[1])
            & (ys[i] < high[1])
            & (zs[i] > low[2])
            & (zs[i] < high[2])
        )
    return left


@njit(**INNER)
def misses(x, y, z, slack, aside, reach, share, twist_per_radian, rays):  # type: ignore[no-untyped-def]
    """Return True if no point near a point in F can be in the frame's beam.

    ``slack`` and ``aside`` are the largest distances from it in any direction and along Z in m,
    ``reach`` the (samples,) half width of the beam in elevation in m, ``share`` a factor on it.
    """
    q = y + rays.centre_offset
    d = np.sqrt(q * q + x * x) - rays.array_radius
    last = len(reach) - 1
    at = np.int64(d * rays.samples_per_metre)
    span = np.int64(slack * rays.samples_per_metre) + 1
    if at < -span or at > last + span:
        return True
    turn = y * twist_per_radian * np.arctan(x / max(q, slack))
    widest = max(reach[min(max(at - span, 0), last)], reach[max(min(at + span, last), 0)])
    return abs(z - turn) > share * widest + aside + abs(twist_per_radian) * slack
