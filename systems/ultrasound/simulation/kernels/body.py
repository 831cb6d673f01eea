"""Body of the tissue: a box that may be round along some of its axes, as `BodySurface.bounds`."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.kernels import INNER


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
