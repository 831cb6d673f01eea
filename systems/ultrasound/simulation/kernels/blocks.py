"""The scatterer tile, the blocks of it that a frame meets, and the body that they lie in."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER
from sonoservo.systems.ultrasound.simulation.kernels.vector_addition import LANES

BLOCKS = 8
"""Number of blocks along an edge of the scatterer tile."""

_SCATTERERS_PER_BLOCK = 160
_MAX_BLOCK = 4e-3


class ScattererTile(NamedTuple):
    """Scatterers that fill the tissue frame periodically.

    The cube is divided into blocks, so that a thin slab of the tissue can be gathered without
    visiting the rest. The whole tile stays in a processor's cache.
    """

    block_size: float
    """Edge of a block in m; the tile's edge is `BLOCKS` times that."""
    positions: NDArray[np.float32]
    """(3, n + LANES) positions within the block, in m; the last ones are never used."""
    ranks: NDArray[np.float32]
    """(n + LANES,) numbers in [0, 1), rising within a block: a random share p lies below p."""
    starts: NDArray[np.int64]
    """(BLOCKS^3 + 1,) first scatterers of the blocks, with x varying slowest."""


def scatterer_tile(density: float, rng: np.random.Generator) -> ScattererTile:
    """Fill a tile with independent scatterers, ``density`` in a m^3."""
    block_size = min((_SCATTERERS_PER_BLOCK / density) ** (1 / 3), _MAX_BLOCK)
    counts = rng.poisson(density * block_size**3, BLOCKS**3)
    starts = np.concatenate([[0], np.cumsum(counts)])
    ranks = rng.random(starts[-1], dtype=np.float32)
    block = np.repeat(np.arange(BLOCKS**3), counts)
    return ScattererTile(
        block_size=block_size,
        positions=np.pad(
            (rng.random((3, starts[-1])) * block_size).astype(np.float32), ((0, 0), (0, LANES))
        ),
        ranks=np.pad(ranks[np.lexsort((ranks, block))], (0, LANES)),
        starts=starts,
    )


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


@njit(**INNER)
def way_through(point, direction, box):  # type: ignore[no-untyped-def]
    """Return the distances in m at which a ray in T enters and leaves the body.

    The first is 0 inside it; the second is the smaller if the ray misses the body.
    """
    enter = 0.0
    leave = np.inf
    for axis in range(3):
        start = point[axis]
        slope = direction[axis]
        if abs(slope) < 1e-9:
            if start < box[0, axis] or start > box[1, axis]:
                leave = -1.0
            continue
        near = (box[0, axis] - start) / slope
        far = (box[1, axis] - start) / slope
        enter = max(enter, min(near, far))
        leave = min(leave, max(near, far))
    if len(box) < 3:
        return enter, leave
    a = 0.0
    b = 0.0
    c = -1.0
    for axis in range(3):
        half = (box[1, axis] - box[0, axis]) / 2
        u = box[2, axis] * (point[axis] - (box[1, axis] + box[0, axis]) / 2) / half
        w = box[2, axis] * direction[axis] / half
        a += w * w
        b += u * w
        c += u * u
    root = b * b - a * c
    if a == 0:
        return enter, (leave if c <= 0 else -1.0)
    if root < 0:
        return enter, -1.0
    root = np.sqrt(root)
    return max(enter, (-b - root) / a), min(leave, (-b + root) / a)


@njit(**INNER)
def keep_inside(chosen, count, xs, ys, zs, x0, y0, z0, box):  # type: ignore[no-untyped-def]
    """Remove chosen scatterers that lie outside a curved body; return the number left."""
    centre_x = (box[1, 0] + box[0, 0]) / 2
    centre_y = (box[1, 1] + box[0, 1]) / 2
    centre_z = (box[1, 2] + box[0, 2]) / 2
    per_x = box[2, 0] * 2 / (box[1, 0] - box[0, 0])
    per_y = box[2, 1] * 2 / (box[1, 1] - box[0, 1])
    per_z = box[2, 2] * 2 / (box[1, 2] - box[0, 2])
    left = 0
    for number in range(count):
        i = chosen[number]
        u = per_x * (x0 + xs[i] - centre_x)
        v = per_y * (y0 + ys[i] - centre_y)
        w = per_z * (z0 + zs[i] - centre_z)
        if u * u + v * v + w * w <= 1:
            chosen[left] = i
            left += 1
    return left
