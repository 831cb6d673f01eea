"""Displacement of the tissue by a needle, drag along its shaft and its volume; points on shafts."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.kernels import INNER, OPTIONS


@njit(**OPTIONS)
def spaced(shaft, spacing):  # type: ignore[no-untyped-def]
    """Return evenly spaced points along an (m, 3) shaft, m or more, ``spacing`` m apart at most."""
    ends = np.zeros(len(shaft))
    for k in range(1, len(shaft)):
        dx = shaft[k, 0] - shaft[k - 1, 0]
        dy = shaft[k, 1] - shaft[k - 1, 1]
        dz = shaft[k, 2] - shaft[k - 1, 2]
        ends[k] = ends[k - 1] + np.sqrt(dx * dx + dy * dy + dz * dz)
    length = ends[-1]
    count = max(int(np.ceil(length / spacing)) + 1, len(shaft))
    points = np.empty((count, 3))
    points[-1] = shaft[-1]
    k = 0
    for i in range(count - 1):
        along = i * (length / (count - 1))
        while k < len(shaft) - 2 and ends[k + 1] <= along:
            k += 1
        for axis in range(3):
            slope = (shaft[k + 1, axis] - shaft[k, axis]) / (ends[k + 1] - ends[k])
            points[i, axis] = slope * (along - ends[k]) + shaft[k, axis]
    return points


@njit(**INNER)
def nearest_on_shaft(x, y, z, field):  # type: ignore[no-untyped-def]
    """Return the distance in m from a frame's needle, and its nearest segment."""
    shaft = field.shaft
    least = np.inf
    nearest = 0
    for k in range(field.points - 1):
        ax = shaft[k + 1, 0] - shaft[k, 0]
        ay = shaft[k + 1, 1] - shaft[k, 1]
        az = shaft[k + 1, 2] - shaft[k, 2]
        bx = x - shaft[k, 0]
        by = y - shaft[k, 1]
        bz = z - shaft[k, 2]
        length = ax * ax + ay * ay + az * az
        at = min(max((bx * ax + by * ay + bz * az) / max(length, 1e-18), 0.0), 1.0)
        bx -= at * ax
        by -= at * ay
        bz -= at * az
        squared = bx * bx + by * by + bz * bz
        if squared < least:
            least = squared
            nearest = k
    return np.sqrt(least), nearest


@njit(**OPTIONS)
def segments_of(shaft):  # type: ignore[no-untyped-def]
    """Return (m - 1, 6) segments of an (m, 3) shaft, for `push`.

    They are their unit directions, their lengths, and how far they begin from entry and tip.
    """
    last = len(shaft) - 1
    segments = np.empty((max(last, 0), 6))
    for k in range(last):
        dx = shaft[k + 1, 0] - shaft[k, 0]
        dy = shaft[k + 1, 1] - shaft[k, 1]
        dz = shaft[k + 1, 2] - shaft[k, 2]
        length = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        dx /= length
        dy /= length
        dz /= length
        entry = (shaft[k, 0] - shaft[0, 0]) * dx
        entry += (shaft[k, 1] - shaft[0, 1]) * dy + (shaft[k, 2] - shaft[0, 2]) * dz
        tip = (shaft[k, 0] - shaft[last, 0]) * dx
        tip += (shaft[k, 1] - shaft[last, 1]) * dy + (shaft[k, 2] - shaft[last, 2]) * dz
        segments[k] = (dx, dy, dz, length, entry, tip)
    return segments


@njit(**INNER)
def push(x, y, z, k, field):  # type: ignore[no-untyped-def]
    """Return the displacement of a point by segment k of a needle, and how the drag changes.

    The point is relative to the segment's beginning, in m. The results are the displacement in m,
    the slope of the drag away from the needle per m of the vector that follows, and that vector
    from the needle's nearest point.
    """
    segment, hole = field.segments[k], field.hole
    dx, dy, dz, length, entry, tip = (
        segment[0], segment[1], segment[2], segment[3], segment[4], segment[5]
    )  # fmt: skip
    px, py, pz = x, y, z
    along = px * dx + py * dy + pz * dz
    clipped = min(max(along, 0.0), length)
    px -= clipped * dx
    py -= clipped * dy
    pz -= clipped * dz
    distance = np.sqrt(px * px + py * py + pz * pz)
    u = field.drag * np.exp(-distance / field.drag_reach)
    slope = -u / (field.drag_reach * max(distance, 1e-6))
    w = 0.0
    if hole > 0:
        over = along - clipped
        first = along + entry
        beyond = along + tip
        rr = max(distance * distance - over * over, 0.0)
        from_entry = np.sqrt(first * first + rr + 1e-12)
        from_tip = np.sqrt(beyond * beyond + rr + 1e-12)
        opened = 0.5 * hole * max(first / from_entry - beyond / from_tip, 0.0)
        # The same as (sqrt(r^2 + opened) - r) / r.
        r = np.sqrt(rr)
        w = opened / ((np.sqrt(rr + opened) + r + 1e-12) * max(r, 1e-9))
        u += (
            0.25
            * hole
            * (
                1 / np.sqrt(from_tip * from_tip + hole)
                - 1 / np.sqrt(from_entry * from_entry + hole)
            )
        )
        u -= w * over
    return u * dx + w * px, u * dy + w * py, u * dz + w * pz, slope, px, py, pz


@njit(**INNER)
def push_scatterers(moved, xs, ys, zs, x0, y0, z0, k, field):  # type: ignore[no-untyped-def]
    """Write (3, n) positions of a block's scatterers, displaced by segment k of the needle."""
    x0 -= field.shaft[k, 0]
    y0 -= field.shaft[k, 1]
    z0 -= field.shaft[k, 2]
    for i in range(len(xs)):
        ux, uy, uz, _, _, _, _ = push(x0 + xs[i], y0 + ys[i], z0 + zs[i], k, field)
        moved[0, i] = xs[i] + ux
        moved[1, i] = ys[i] + uy
        moved[2, i] = zs[i] + uz
