"""Interpolation of a sweep's samples where the tissue was seen by a moving probe.

The motion shifts a point's place in the image by an amount that varies slowly from point to point.
It is worked out at some of the grid's elements, and interpolated between these nodes.
"""

import numpy as np
from numba import njit, prange

from sonoservo.systems.sampling.kernels import OPTIONS
from sonoservo.systems.ultrasound.resampling import (
    frame_of,
    interpolate,
    line_of,
    project,
    sweeps,
)

POSES_PER_FRAME = 16
"""Number of poses tabulated from one frame to the next; at 20 mm/s they are 0.01 mm apart."""

FRAMES_BEYOND = 4
"""Number of frames before the first one and after the last for which poses are extrapolated.

The nodes around an element at the sector's edge are that far outside.
"""

NODE_STRIDE = 8
"""Elements from one node to the next of the table of the probe's motion (`tabulate_shifts`)."""

_ZERO, _HALF, _ONE = (np.float32(value) for value in (0, 0.5, 1))
_NEXT = np.uint64(1)


@njit(parallel=True, **OPTIONS)
def tabulate_shifts(shifts, sector, x, y, z, poses):  # type: ignore[no-untyped-def]
    """Write how far the motion of the probe moves points in its image, at nodes in m.

    The (mx, my, 3, mz) float32 shifts are changes of step, line and distance (see `project`). Poses
    are (n, 12) rows of 3 x 4 matrices from the volume's frame to the probe's at the time,
    `POSES_PER_FRAME` to a frame, from `FRAMES_BEYOND` frames before the first to as many after the
    last; the origin is on the motor's axis.
    """
    for a in prange(len(x)):
        for b in range(len(y)):
            for c in range(len(z)):
                # The time at which a point was seen depends on its place at that time. Each pass
                # reduces the error to a tenth.
                at_rest = project(x[a], y[b], z[c], sector)
                place = _seen(x[a], y[b], z[c], at_rest, poses, sector)
                place = _seen(x[a], y[b], z[c], place, poses, sector)
                place = _seen(x[a], y[b], z[c], place, poses, sector)
                for each in range(3):
                    shifts[a, b, each, c] = place[each] - at_rest[each]


@njit(parallel=True, **OPTIONS)
def resample_moving(  # type: ignore[no-untyped-def]
    volume, seen, rows, packed, beyond, corners, sector, x, distance, step, shifts, nodes, row
):
    """Fill the part of a volume that the sweep of a moving probe covers; see `resample`.

    ``seen``, uint8 zeros, is set to 1 there. ``shifts`` has a node at every `NODE_STRIDE`-th
    element; nodes and row are float32 memory for those along a row, (nx, 3, mz) and
    (nx, 3, mz `NODE_STRIDE`).
    """
    share = _ONE / np.float32(NODE_STRIDE)
    for a in prange(volume.shape[0]):
        i = np.uint64(a) // np.uint64(NODE_STRIDE)
        u = np.float32(np.int64(a) % NODE_STRIDE) * share
        for b in range(volume.shape[1]):
            j = np.uint64(b) // np.uint64(NODE_STRIDE)
            v = np.float32(b % NODE_STRIDE) * share
            for part in range(2):
                first, end = rows[a, b, part, 0], rows[a, b, part, 1]
                first_node = np.uint64(first // NODE_STRIDE)
                last_node = np.uint64((end + NODE_STRIDE - 1) // NODE_STRIDE)
                for each in range(3):
                    for c in range(first_node, last_node + np.uint64(1)):
                        nodes[a, each, c] = _blend(shifts, i, j, each, c, u, v)
                    for c in range(first_node, last_node):
                        near = nodes[a, each, c]
                        slope = share * (nodes[a, each, c + np.uint64(1)] - near)
                        at = c * np.uint64(NODE_STRIDE)
                        for k in range(np.uint64(NODE_STRIDE)):
                            row[a, each, at + k] = near + np.float32(k) * slope
                # Three loops, each of which the compiler can vectorise.
                for n in range(np.uint64(first), np.uint64(end)):
                    line, r = line_of(x[a], distance[b, n], sector)
                    row[a, 0, n] = step[b, n] + row[a, 0, n]
                    row[a, 1, n] = line + row[a, 1, n]
                    row[a, 2, n] = r + row[a, 2, n]
                for n in range(np.uint64(first), np.uint64(end)):
                    volume[a, b, n] = interpolate(
                        packed, beyond, corners, sector, row[a, 0, n], row[a, 1, n], row[a, 2, n]
                    )
                for n in range(np.uint64(first), np.uint64(end)):
                    swept = sweeps(sector, row[a, 0, n], row[a, 1, n], row[a, 2, n])
                    seen[a, b, n] = np.uint8(1) if swept else np.uint8(0)


@njit(**OPTIONS)
def _blend(shifts, i, j, each, c, u, v):  # type: ignore[no-untyped-def]
    """Interpolate a shift between the four nodes around a row."""
    near = shifts[i, j, each, c] + u * (shifts[i + _NEXT, j, each, c] - shifts[i, j, each, c])
    far = shifts[i, j + _NEXT, each, c] + u * (
        shifts[i + _NEXT, j + _NEXT, each, c] - shifts[i, j + _NEXT, each, c]
    )
    return near + v * (far - near)


@njit(**OPTIONS)
def _seen(x, y, z, place, poses, sector):  # type: ignore[no-untyped-def]
    """Project a point as the probe saw it at the time the sweep was at a place; see `project`."""
    step, line, _ = place
    beyond = np.float32(FRAMES_BEYOND)
    frame = min(max(frame_of(step, line, sector), -beyond), sector.last_frame + beyond)
    n = np.uint32(np.int32(np.float32(POSES_PER_FRAME) * (frame + beyond) + _HALF))
    return project(
        poses[n, 0] * x + poses[n, 1] * y + poses[n, 2] * z + poses[n, 3],
        poses[n, 4] * x + poses[n, 5] * y + poses[n, 6] * z + poses[n, 7],
        poses[n, 8] * x + poses[n, 9] * y + poses[n, 10] * z + poses[n, 11],
        sector,
    )
