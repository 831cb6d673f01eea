"""Displacement of the tissue by an indenting probe and by a needle, with its gradient."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.needle_push import (
    nearest_on_shaft,
    push,
    segments_of,
)

_SHALLOWEST = 1e-4
_FARTHEST = 0.95


class Displacements(NamedTuple):
    """Fields of displacement in T, one for each frame."""

    contacts: NDArray[np.float64]
    """(frames, 2) x and y of the middle of the contact on the undeformed top, in m."""
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


class FrameField(NamedTuple):
    """Field of displacement of one frame; see `Displacements`.

    Kernels pass it on instead of the fields of all frames, whose many arrays make calls expensive.
    """

    x: float
    y: float
    depth: float
    radius: float
    drag: float
    drag_reach: float
    hole: float
    widest_push: float
    points: int
    shaft: NDArray[np.float64]
    segments: NDArray[np.float64]
    """See `segments_of`."""


NO_DISPLACEMENTS = Displacements(
    contacts=np.empty((0, 2)),
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
def frame_field(fields, frame):  # type: ignore[no-untyped-def]
    """Return the `FrameField` of a frame; nothing moves in it if there are no fields."""
    if len(fields.counts) == 0:
        return FrameField(
            0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0, np.empty((0, 3)), np.empty((0, 6))
        )
    points = fields.counts[frame]
    return FrameField(
        fields.contacts[frame, 0],
        fields.contacts[frame, 1],
        fields.depths[frame],
        fields.radii[frame],
        fields.drags[frame],
        fields.drag_reach,
        fields.hole,
        fields.widest_push,
        points,
        fields.shafts[frame],
        segments_of(fields.shafts[frame, :points]),
    )


@njit(**INNER)
def indent(x, y, z, field, F):  # type: ignore[no-untyped-def]
    """Return the displacement in m of a point in T by a rigid sphere, and write its gradient."""
    # The field is that of Hertz's contact with an incompressible elastic half-space, whose surface
    # is T's level top with the normal n into the tissue. With Poisson's ratio 1/2, Boussinesq's
    # potentials (Johnson 1985, section 3.2) reduce to u = (V n - d grad V) / 2G, where d is the
    # depth and V the Newtonian potential of the pressure. That of Hertz's pressure is the limit of
    # a homogeneous ellipsoid that is flattened to a disc of radius a: V / 2G = (depth a / pi)
    # int_lambda^inf (1 - r^2/(a^2+s) - d^2/s) ds / ((a^2+s) sqrt(s)), where r is the distance from
    # the axis and r^2/(a^2+lambda) + d^2/lambda = 1.
    a = field.radius
    px = x - field.x
    py = y - field.y
    # At the surface itself the formulae divide zero by zero.
    d = max(-z, _SHALLOWEST * a)
    rr = px * px + py * py
    aa = a * a
    b = rr + d * d - aa
    root = np.sqrt(b * b + 4 * aa * d * d)
    tt = 0.5 * (b + root) if b > 0 else 2 * aa * d * d / (root - b)
    t = np.sqrt(tt)
    s = aa + tt
    theta = np.arctan2(a, t)
    first = theta / (aa * a) - t / (aa * s)
    second = 2 / (aa * t) - 2 * theta / (aa * a)
    scale = field.depth * a / np.pi
    # V = scale (2 theta / a - r^2 first - d^2 second), and its gradient is p (px, py, 0) + q n.
    p = -2 * scale * first
    q = -2 * scale * d * second
    V = scale * (2 * theta / a - rr * first - d * d * second)
    # Derivatives of p and q by way of t, whose gradient is by_r (px, py, 0) + by_d n.
    inverse = 1 / (t * rr / (s * s) + d * d / (tt * t))
    p_t = 4 * scale / (s * s) * inverse
    both = d * d / tt * p_t
    aside = d / s * p_t
    ahead = d * (4 * scale * d * d / (tt * tt * s) * inverse - 2 * scale * second - p)
    one = 1 - d * p
    F[0, 0] = one - aside * px * px
    F[0, 1] = -aside * px * py
    F[0, 2] = (p + both) * px
    F[1, 0] = F[0, 1]
    F[1, 1] = one - aside * py * py
    F[1, 2] = (p + both) * py
    F[2, 0] = (both - p) * px
    F[2, 1] = (both - p) * py
    F[2, 2] = one - ahead
    return -d * p * px, -d * p * py, d * q - V


@njit(**INNER)
def displace(x, y, z, field, pushed, F):  # type: ignore[no-untyped-def]
    """Return the displaced position in T, in m, of a point in T, and write its gradient.

    The gradient leaves out that tissue gives way to the needle's volume.
    """
    # The needle, unless it does not push the point, drags tissue along, less and less with the
    # distance from its shaft. Incompressible tissue also gives way: at a distance r from the middle
    # of a long needle of radius R it moves to sqrt(r^2 + R^2) (expansion of a cylindrical cavity).
    # At its ends the field is that of a line of sources. The probe then displaces the tissue with
    # the needle.
    dx, dy, dz, slope, px, py, pz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if pushed and field.points > 1:
        k = 0
        if field.points > 2:
            _, k = nearest_on_shaft(x, y, z, field)
        dx, dy, dz = field.segments[k, 0], field.segments[k, 1], field.segments[k, 2]
        ux, uy, uz, slope, px, py, pz = push(
            x - field.shaft[k, 0], y - field.shaft[k, 1], z - field.shaft[k, 2], k, field
        )
        x += ux
        y += uy
        z += uz
    if field.depth > 0:
        ux, uy, uz = indent(x, y, z, field, F)
        x += ux
        y += uy
        z += uz
    else:
        for i in range(3):
            for j in range(3):
                F[i, j] = 1.0 if i == j else 0.0
    if slope != 0:
        # The needle's gradient is I + slope d p'.
        for i in range(3):
            along = slope * (F[i, 0] * dx + F[i, 1] * dy + F[i, 2] * dz)
            F[i, 0] += along * px
            F[i, 1] += along * py
            F[i, 2] += along * pz
    return x, y, z


@njit(**INNER)
def displacement_limit(x, y, z, field):  # type: ignore[no-untyped-def]
    """Return an upper limit in m of the displacement of a point in T; see `displace`."""
    limit = field.widest_push
    if field.depth > 0:
        px = x - field.x
        py = y - field.y
        # Boussinesq's point load moves the tissue most below itself: by 8 depth a / 3 pi r.
        far = _FARTHEST * field.radius / np.sqrt(px * px + py * py + z * z + 1e-9)
        limit += field.depth * min(far, 1.0)
    return limit


@njit(**INNER)
def limit_along(limit, cosine, field):  # type: ignore[no-untyped-def]
    """Return an upper limit in m of a displacement's component along a direction.

    Boussinesq's point load moves tissue sideways by at most a quarter of the greatest displacement:
    sin(t) cos(t) / 2 at an angle t to the load. The cosine is that to the vertical.
    """
    pressed = limit - field.widest_push
    return field.widest_push + min(abs(cosine) + 0.25, 1.0) * pressed


@njit(**OPTIONS)
def displace_points(points, fields, frame, pushed):  # type: ignore[no-untyped-def]
    """Return the (n, 3) displaced positions of (n, 3) points in T, in m; see `displace`."""
    field = frame_field(fields, frame)
    moved = np.empty_like(points)
    F = np.empty((3, 3))
    for i in range(len(points)):
        x, y, z = displace(points[i, 0], points[i, 1], points[i, 2], field, pushed, F)
        moved[i, 0] = x
        moved[i, 1] = y
        moved[i, 2] = z
    return moved
