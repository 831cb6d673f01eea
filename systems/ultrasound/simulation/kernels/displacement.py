"""Displacement of the tissue by an indenting probe and by a needle, with its gradient."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.options import OPTIONS

_SHALLOWEST = 1e-4


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
    margin: float
    """Upper limit of all displacements, in m."""


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
    by_r = inverse / s
    by_d = inverse * d / tt
    p_t = 4 * scale / (s * s)
    q_t = 4 * scale * d / (tt * s)
    pn = (px, py, pz)
    for i in range(3):
        gi = p * pn[i] + q * n[i]
        for j in range(3):
            gj = p * pn[j] + q * n[j]
            hessian = pn[i] * p_t * (by_r * pn[j] + by_d * n[j])
            hessian += n[i] * (q_t * (by_r * pn[j] + by_d * n[j]) - (2 * scale * second + p) * n[j])
            if i == j:
                hessian += p
            F[i, j] = (1.0 if i == j else 0.0) + n[i] * gj - n[j] * gi - d * hessian
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
    for i in range(3):
        for j in range(3):
            F[i, j] = 1.0 if i == j else 0.0
    count = field.counts[frame]
    if count < 2:
        return 0.0, 0.0, 0.0
    distance, k, share = nearest_on_shaft(x, y, z, field, frame)
    shaft = field.shafts[frame]
    dx = shaft[k + 1, 0] - shaft[k, 0]
    dy = shaft[k + 1, 1] - shaft[k, 1]
    dz = shaft[k + 1, 2] - shaft[k, 2]
    px = x - shaft[k, 0] - share * dx
    py = y - shaft[k, 1] - share * dy
    pz = z - shaft[k, 2] - share * dz
    length = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
    dx /= length
    dy /= length
    dz /= length
    u = field.drags[frame] * np.exp(-distance / field.drag_reach)
    slope = -u / (field.drag_reach * max(distance, 1e-6))
    ahead = (dx, dy, dz)
    aside = (px, py, pz)
    for i in range(3):
        for j in range(3):
            F[i, j] += slope * ahead[i] * aside[j]
    w = 0.0
    if field.hole > 0:
        last = count - 1
        ends = np.empty(2)
        for end in range(2):
            m = last * end
            ends[end] = (x - shaft[m, 0]) * dx + (y - shaft[m, 1]) * dy + (z - shaft[m, 2]) * dz
        along = px * dx + py * dy + pz * dz
        px -= along * dx
        py -= along * dy
        pz -= along * dz
        rr = px * px + py * py + pz * pz
        from_entry = np.sqrt(ends[0] * ends[0] + rr + 1e-12)
        from_tip = np.sqrt(ends[1] * ends[1] + rr + 1e-12)
        opened = 0.5 * field.hole * (ends[0] / from_entry - ends[1] / from_tip)
        r = np.sqrt(rr)
        w = (np.sqrt(rr + max(opened, 0.0)) - r) / max(r, 1e-9)
        u += (
            0.25
            * field.hole
            * (
                1 / np.sqrt(from_tip * from_tip + field.hole)
                - 1 / np.sqrt(from_entry * from_entry + field.hole)
            )
        )
    return u * dx + w * px, u * dy + w * py, u * dz + w * pz


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
        for i in range(3):
            for j in range(3):
                F[i, j] = 1.0 if i == j else 0.0
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
def displace_points(points, field, frame, pushed):  # type: ignore[no-untyped-def]
    """Return the (n, 3) displaced positions of (n, 3) points in T, in m; see `displace`."""
    moved = np.empty_like(points)
    F = np.empty((3, 3))
    G = np.empty((3, 3))
    for i in range(len(points)):
        moved[i] = displace(points[i, 0], points[i, 1], points[i, 2], field, frame, pushed, F, G)
    return moved


@njit(**OPTIONS)
def push_scatterers(moved, xs, ys, zs, x0, y0, z0, field, frame, G):  # type: ignore[no-untyped-def]
    """Write the (3, n) positions of a block's scatterers near the needle, displaced by it.

    Parameters
    ----------
    moved
        (3, n) float32 positions within the block, written.
    xs, ys, zs
        (n,) undisplaced positions within the block, in m.
    x0, y0, z0
        Corner of the block in T, in m.
    field, frame
        See `indent`.
    G
        (3, 3) memory, overwritten.
    """
    for i in range(len(xs)):
        ux, uy, uz = push(x0 + xs[i], y0 + ys[i], z0 + zs[i], field, frame, G)
        moved[0, i] = xs[i] + ux
        moved[1, i] = ys[i] + uy
        moved[2, i] = zs[i] + uz
