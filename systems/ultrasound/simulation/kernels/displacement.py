"""Displacement of the tissue by an indenting probe and by a needle, with its gradient."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.options import OPTIONS

_SHALLOWEST = 1e-4
_FARTHEST = 0.95


class Displacements(NamedTuple):
    """Fields of displacement in T, one for each frame."""

    centres: NDArray[np.float64]
    """(frames, 3) centres of the contact on the undeformed surface, in m."""
    normals: NDArray[np.float64]
    """(frames, 3) unit normals of the surface, into the tissue."""
    depths: NDArray[np.float64]
    """(frames,) depths of the indentation, in m; 0 for none."""
    radii: NDArray[np.float64]
    """(frames,) radii of the contact, in m; above 0."""
    shafts: NDArray[np.float64]
    """(frames, m, 3) points along the undisplaced needle, entry first, in m."""
    counts: NDArray[np.int64]
    """(frames,) numbers of valid points in ``shafts``: 0 for no needle."""
    drags: NDArray[np.float64]
    """(frames,) displacements of the tissue at the shaft towards the tip, in m."""
    drag_reach: float
    """Distance from the shaft over which the drag falls to 1/e, in m."""
    hole: float
    """Square of the radius of the hole that the tissue leaves to the needle, in m^2."""
    deepest: float
    """Greatest of the depths, in m."""
    widest_push: float
    """Upper limit of all displacements by the needle, in m."""


NO_DISPLACEMENTS = Displacements(
    centres=np.empty((0, 3)),
    normals=np.empty((0, 3)),
    depths=np.empty(0),
    radii=np.empty(0),
    shafts=np.empty((0, 0, 3)),
    counts=np.empty(0, np.int64),
    drags=np.empty(0),
    drag_reach=1.0,
    hole=0.0,
    deepest=0.0,
    widest_push=0.0,
)
"""Fields of tissue that nothing deforms."""


@njit(**OPTIONS)
def _add_products(F, one, nx, ny, nz, px, py, pz, np_, pn, pp, nn):  # type: ignore[no-untyped-def]
    """Write one I + np_ n p' + pn p n' - pp p p' - nn n n' to F."""
    for i in range(3):
        a = nx if i == 0 else (ny if i == 1 else nz)
        b = px if i == 0 else (py if i == 1 else pz)
        along = pn * b - nn * a
        aside = np_ * a - pp * b
        F[i, 0] = along * nx + aside * px
        F[i, 1] = along * ny + aside * py
        F[i, 2] = along * nz + aside * pz
        F[i, i] += one


@njit(**OPTIONS)
def indent(x, y, z, field, frame, F):  # type: ignore[no-untyped-def]
    """Return the displacement in m of a point in T by a rigid sphere, and write its gradient.

    The field is that of Hertz's contact with an incompressible elastic half-space. With Poisson's
    ratio 1/2, Boussinesq's potentials (Johnson 1985, section 3.2) reduce to u = (V n - d grad V) /
    2G, where d is the depth and V the Newtonian potential of the pressure. That of Hertz's pressure
    is the limit of a homogeneous ellipsoid that is flattened to a disc of radius a:

        V / 2G = (depth a / pi) int_lambda^inf (1 - r^2/(a^2+s) - d^2/s) ds / ((a^2+s) sqrt(s)),

    where r is the distance from the axis and r^2/(a^2+lambda) + d^2/lambda = 1.

    Parameters
    ----------
    x, y, z
        Coordinates of the point, in m.
    field, frame
        `Displacements`, and the frame's number.
    F
        (3, 3) gradient of the displaced position, written.
    """
    n = field.normals[frame]
    a = field.radii[frame]
    px = x - field.centres[frame, 0]
    py = y - field.centres[frame, 1]
    pz = z - field.centres[frame, 2]
    d = px * n[0] + py * n[1] + pz * n[2]
    px -= d * n[0]
    py -= d * n[1]
    pz -= d * n[2]
    # At the surface itself the formulae divide zero by zero.
    d = max(d, _SHALLOWEST * a)
    rr = px * px + py * py + pz * pz
    aa = a * a
    b = rr + d * d - aa
    root = np.sqrt(b * b + 4 * aa * d * d)
    tt = 0.5 * (b + root) if b > 0 else 2 * aa * d * d / (root - b)
    t = np.sqrt(tt)
    s = aa + tt
    theta = np.arctan2(a, t)
    first = theta / (aa * a) - t / (aa * s)
    second = 2 / (aa * t) - 2 * theta / (aa * a)
    scale = field.depths[frame] * a / np.pi
    # V = scale (2 theta / a - r^2 first - d^2 second), and its gradient is p (px, py, pz) + q n.
    p = -2 * scale * first
    q = -2 * scale * d * second
    V = scale * (2 * theta / a - rr * first - d * d * second)
    # Derivatives of p and q by way of t, whose gradient is by_r (px, py, pz) + by_d n.
    inverse = 1 / (t * rr / (s * s) + d * d / (tt * t))
    p_t = 4 * scale / (s * s) * inverse
    both = d * d / tt * p_t
    aside = d / s * p_t
    ahead = d * (4 * scale * d * d / (tt * tt * s) * inverse - 2 * scale * second - p)
    _add_products(F, 1 - d * p, n[0], n[1], n[2], px, py, pz, p - both, -p - both, aside, ahead)
    along = V - d * q
    return along * n[0] - d * p * px, along * n[1] - d * p * py, along * n[2] - d * p * pz


@njit(**OPTIONS)
def nearest_on_shaft(x, y, z, field, frame):  # type: ignore[no-untyped-def]
    """Return the distance in m from a frame's needle, its nearest segment, and the place on it."""
    shaft = field.shafts[frame]
    least = np.inf
    nearest = 0
    share = 0.0
    for k in range(field.counts[frame] - 1):
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
            share = at
    return np.sqrt(least), nearest, share


@njit(**OPTIONS)
def _segment(field, frame, k):  # type: ignore[no-untyped-def]
    """Return a segment's unit direction, its length, and how far it begins from entry and tip."""
    shaft = field.shafts[frame]
    last = field.counts[frame] - 1
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
    return dx, dy, dz, length, entry, tip


@njit(**OPTIONS)
def _push(px, py, pz, dx, dy, dz, length, entry, tip, drag, reach, hole):  # type: ignore[no-untyped-def]
    """Return the displacement by a segment of a needle, and how the drag changes.

    Parameters
    ----------
    px, py, pz
        Point relative to the segment's beginning, in m.
    dx, dy, dz, length, entry, tip
        See `_segment`.
    drag, reach, hole
        See `Displacements`.

    Returns
    -------
    Displacement in m; slope of the drag away from the needle, per m of the vector that follows; and
    the vector from the nearest point of the needle.
    """
    along = px * dx + py * dy + pz * dz
    clipped = min(max(along, 0.0), length)
    px -= clipped * dx
    py -= clipped * dy
    pz -= clipped * dz
    distance = np.sqrt(px * px + py * py + pz * pz)
    u = drag * np.exp(-distance / reach)
    slope = -u / (reach * max(distance, 1e-6))
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


@njit(**OPTIONS)
def push(x, y, z, field, frame, F):  # type: ignore[no-untyped-def]
    """Return the displacement in m of a point in T by the needle, and write that of its gradient.

    The needle drags tissue along, less and less with the distance from its shaft. Tissue also gives
    way to the needle's volume: incompressible tissue at a distance r from the middle of a long
    needle of radius R moves to sqrt(r^2 + R^2) (expansion of a cylindrical cavity). At its ends the
    field is that of a line of sources. The gradient leaves out the second effect.

    Parameters
    ----------
    x, y, z, field, frame
        See `indent`.
    F
        (3, 3) gradient of the displaced position, written.
    """
    if field.counts[frame] < 2:
        _add_products(F, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return 0.0, 0.0, 0.0
    _, k, _ = nearest_on_shaft(x, y, z, field, frame)
    dx, dy, dz, length, entry, tip = _segment(field, frame, k)
    x -= field.shafts[frame, k, 0]
    y -= field.shafts[frame, k, 1]
    z -= field.shafts[frame, k, 2]
    drag, reach, hole = field.drags[frame], field.drag_reach, field.hole
    ux, uy, uz, slope, px, py, pz = _push(
        x, y, z, dx, dy, dz, length, entry, tip, drag, reach, hole
    )
    _add_products(F, 1.0, dx, dy, dz, px, py, pz, slope, 0.0, 0.0, 0.0)
    return ux, uy, uz


@njit(**OPTIONS)
def displace(x, y, z, field, frame, pushed, F, G):  # type: ignore[no-untyped-def]
    """Return the displaced position in T, in m, of a point in T, and write its gradient.

    Parameters
    ----------
    x, y, z, field, frame
        See `indent`.
    pushed
        Whether the needle displaces the point, before the probe does.
    F
        (3, 3) gradient of the displaced position, written.
    G
        (3, 3) memory, overwritten.
    """
    if pushed:
        ux, uy, uz = push(x, y, z, field, frame, F)
        x += ux
        y += uy
        z += uz
    else:
        _add_products(F, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if field.depths[frame] > 0:
        ux, uy, uz = indent(x, y, z, field, frame, G)
        x += ux
        y += uy
        z += uz
        for j in range(3):
            a = F[0, j]
            b = F[1, j]
            c = F[2, j]
            for i in range(3):
                F[i, j] = G[i, 0] * a + G[i, 1] * b + G[i, 2] * c
    return x, y, z


@njit(**OPTIONS)
def displacement_limit(x, y, z, field, frame):  # type: ignore[no-untyped-def]
    """Return an upper limit in m of the displacement of a point in T; see `indent` and `push`."""
    limit = field.widest_push
    if field.depths[frame] > 0:
        px = x - field.centres[frame, 0]
        py = y - field.centres[frame, 1]
        pz = z - field.centres[frame, 2]
        # Boussinesq's point load moves the tissue most below itself: by 8 depth a / 3 pi r.
        far = _FARTHEST * field.radii[frame] / np.sqrt(px * px + py * py + pz * pz + 1e-9)
        limit += field.depths[frame] * min(far, 1.0)
    return limit


@njit(**OPTIONS)
def displace_points(points, field, frame, pushed):  # type: ignore[no-untyped-def]
    """Return the (n, 3) displaced positions of (n, 3) points in T, in m; see `displace`."""
    moved = np.empty_like(points)
    F = np.empty((3, 3))
    G = np.empty((3, 3))
    for i in range(len(points)):
        x, y, z = displace(points[i, 0], points[i, 1], points[i, 2], field, frame, pushed, F, G)
        moved[i, 0] = x
        moved[i, 1] = y
        moved[i, 2] = z
    return moved


@njit(**OPTIONS)
def push_scatterers(moved, xs, ys, zs, x0, y0, z0, k, field, frame):  # type: ignore[no-untyped-def]
    """Write the positions of a block's scatterers, displaced by the needle beside them.

    Parameters
    ----------
    moved
        (3, n or more) float32 positions within the block, written.
    xs, ys, zs
        (n,) undisplaced positions within the block, in m.
    x0, y0, z0
        Corner of the block in T, in m.
    k
        Number of the needle's segment nearest to the block.
    field, frame
        See `indent`.
    """
    dx, dy, dz, length, entry, tip = _segment(field, frame, k)
    x0 -= field.shafts[frame, k, 0]
    y0 -= field.shafts[frame, k, 1]
    z0 -= field.shafts[frame, k, 2]
    drag, reach, hole = field.drags[frame], field.drag_reach, field.hole
    for i in range(len(xs)):
        ux, uy, uz, _, _, _, _ = _push(
            x0 + xs[i], y0 + ys[i], z0 + zs[i],
            dx, dy, dz, length, entry, tip, drag, reach, hole,
        )  # fmt: skip
        moved[0, i] = xs[i] + ux
        moved[1, i] = ys[i] + uy
        moved[2, i] = zs[i] + uz
