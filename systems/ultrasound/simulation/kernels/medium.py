"""Propagation of sound through layers of different speed: true and apparent positions.

A scanner assumes a single speed of sound and straight lines. A layer of fat on top of the tissue is
slower, and refracts every line that meets its lower face at an angle (Snell's law). A point behind
it appears on the line that is bent towards it, at the depth given by the time of flight. Tissues
with other speeds change that time along the line.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.displacement import Displacements
from sonoservo.systems.ultrasound.simulation.kernels.needle_push import spaced
from sonoservo.systems.ultrasound.simulation.kernels.projection import transformed

_STEPS = 3
_PROBE = 1e-3
_LEAST_COSINE = 0.1


class Medium(NamedTuple):
    """Layers in front of and around the structures, in the coordinates of every frame."""

    normals: NDArray[np.float64]
    """(frames, 3) unit normals in F of the lower face of the fat, away from the probe."""
    offsets: NDArray[np.float64]
    """(frames,) distances in m of that face from F's origin along the normal; -1e9 for no fat."""
    ratio: float
    """Ratio of the speed of sound in fat to that in the tissue."""
    array_radius: float
    centre_offset: float
    delays: NDArray[np.float32]
    """(frames, lines, nodes) paths in m by which echoes appear deeper; (frames, 0, 0) for none."""
    lines_per_radian: float
    nodes_per_metre: float


class View(NamedTuple):
    """Apparent positions of points in F for every frame, tabulated over angle and depth."""

    table: NDArray[np.float64]
    """(frames, angles, depths, 15) entries: apparent minus true position, derivative of the
    apparent position by the true one, and direction in which sound arrives."""
    angles_per_radian: float
    middle: float
    """Index of the angle 0."""
    nearest: float
    """Distance in m of the first depth from the array's centre of curvature."""
    depths_per_metre: float
    centre_offset: float
    asides: NDArray[np.float64]
    """(frames,) largest changes of the distance from a frame's plane for points near it, in m."""
    furthest: float
    """Largest distance between true and apparent position of points near the plane, in m."""


NO_VIEW = View(np.empty((0, 0, 0, 15)), 1.0, 0.0, 0.0, 1.0, 0.0, np.empty(0), 0.0)
"""View of points that appear at their true positions."""


class Sights(NamedTuple):
    """Where frames see the tissue."""

    X_FT: NDArray[np.float64]
    """(frames, 3, 4) poses of the tissue in each frame's F."""
    fields: Displacements
    """Displacements of the tissue, or `NO_DISPLACEMENTS`."""
    bent: View
    """Apparent positions of points, or `NO_VIEW`."""


@njit(**INNER)
def largest_aside(view, frame):  # type: ignore[no-untyped-def]
    """Return the entry of ``view.asides`` for a frame, and 0 if nothing is bent."""
    return view.asides[frame] if len(view.table) > 0 else 0.0


@njit(**INNER)
def interpolated(table, line, node):  # type: ignore[no-untyped-def]
    """Interpolate a (lines, nodes) table, held constant beyond its edges."""
    line = min(max(line, 0.0), table.shape[0] - 1.0)
    node = min(max(node, 0.0), table.shape[1] - 1.0)
    j = min(np.int64(line), table.shape[0] - 2)
    k = min(np.int64(node), table.shape[1] - 2)
    a = line - j
    b = node - k
    near = (1 - b) * table[j, k] + b * table[j, k + 1]
    return (1 - a) * near + a * ((1 - b) * table[j + 1, k] + b * table[j + 1, k + 1])


@njit(**INNER)
def true_position(x, y, z, medium, frame):  # type: ignore[no-untyped-def]
    """Return the true position in F, in m, of an object that appears at a point in F."""
    delays = medium.delays[frame]
    dy = y + medium.centre_offset
    r = np.sqrt(x * x + dy * dy)
    ux = x / r
    uy = dy / r
    path = r - medium.array_radius
    if delays.shape[0] > 0:
        line = np.arctan2(x, dy) * medium.lines_per_radian + 0.5 * (delays.shape[0] - 1)
        path -= interpolated(delays, line, path * medium.nodes_per_metre)
    ox = medium.array_radius * ux
    oy = medium.array_radius * uy - medium.centre_offset
    offset = medium.offsets[frame]
    nx = medium.normals[frame, 0]
    ny = medium.normals[frame, 1]
    nz = medium.normals[frame, 2]
    ahead = offset - (nx * ox + ny * oy + nz * z)
    cosine = nx * ux + ny * uy
    if ahead <= 0 or cosine <= _LEAST_COSINE:
        return ox + path * ux, oy + path * uy, z
    way = ahead / cosine
    if path * medium.ratio <= way:
        way = path * medium.ratio
        return ox + way * ux, oy + way * uy, z
    eta = 1 / medium.ratio
    sine_squared = min(eta * eta * (1 - cosine * cosine), 1 - _LEAST_COSINE**2)
    along = np.sqrt(1 - sine_squared) - eta * cosine
    rest = path - way / medium.ratio
    return (
        ox + way * ux + rest * (eta * ux + along * nx),
        oy + way * uy + rest * (eta * uy + along * ny),
        z + rest * along * nz,
    )


@njit(**INNER)
def apparent_position(x, y, z, medium, frame):  # type: ignore[no-untyped-def]
    """Return the apparent position in F, in m, of a point in F: the inverse of `true_position`."""
    ax = x
    ay = y
    az = z
    for _ in range(_STEPS):
        tx, ty, tz = true_position(ax, ay, az, medium, frame)
        ax += x - tx
        ay += y - ty
        az += z - tz
    return ax, ay, az


@njit(**INNER)
def linear_view(x, y, z, medium, frame, slope, J):  # type: ignore[no-untyped-def]
    """Return a point's apparent position in F; write its derivative by the true one.

    J is (3, 3) memory.
    """
    ax, ay, az = apparent_position(x, y, z, medium, frame)
    x0, y0, z0 = true_position(ax, ay, az, medium, frame)
    for axis in range(3):
        dx = _PROBE if axis == 0 else 0.0
        dy = _PROBE if axis == 1 else 0.0
        dz = _PROBE if axis == 2 else 0.0
        x1, y1, z1 = true_position(ax + dx, ay + dy, az + dz, medium, frame)
        J[0, axis] = (x1 - x0) / _PROBE
        J[1, axis] = (y1 - y0) / _PROBE
        J[2, axis] = (z1 - z0) / _PROBE
    determinant = 0.0
    for i in range(3):
        j = (i + 1) % 3
        k = (i + 2) % 3
        determinant += J[0, i] * (J[1, j] * J[2, k] - J[1, k] * J[2, j])
    for i in range(3):
        for j in range(3):
            a = (i + 1) % 3
            b = (i + 2) % 3
            c = (j + 1) % 3
            d = (j + 2) % 3
            slope[j, i] = (J[a, c] * J[b, d] - J[a, d] * J[b, c]) / determinant
    # One step of Newton's method from the end of the iteration.
    ax += slope[0, 0] * (x - x0) + slope[0, 1] * (y - y0) + slope[0, 2] * (z - z0)
    ay += slope[1, 0] * (x - x0) + slope[1, 1] * (y - y0) + slope[1, 2] * (z - z0)
    az += slope[2, 0] * (x - x0) + slope[2, 1] * (y - y0) + slope[2, 2] * (z - z0)
    return ax, ay, az


@njit(**OPTIONS)
def tabulate_views(table, medium, view):  # type: ignore[no-untyped-def]
    """Tabulate `linear_view` over the middle plane of every frame, as a `View` has it."""
    _fill_views(table, medium, view, np.empty((3, 3)), np.empty((3, 3)))


@njit(**INNER)
def _fill_views(table, medium, view, slope, J):  # type: ignore[no-untyped-def]
    """Fill the table; slope and J are (3, 3) memory."""
    for frame in range(len(table)):
        for j in range(table.shape[1]):
            phi = (j - view.middle) / view.angles_per_radian
            for k in range(table.shape[2]):
                r = view.nearest + k / view.depths_per_metre
                x = r * np.sin(phi)
                y = r * np.cos(phi) - view.centre_offset
                node = table[frame, j, k]
                ax, ay, az = linear_view(x, y, 0.0, medium, frame, slope, J)
                node[0] = ax - x
                node[1] = ay - y
                node[2] = az
                for row in range(3):
                    for column in range(3):
                        node[3 + 3 * row + column] = slope[row, column]
                dy = ay + view.centre_offset
                there = np.sqrt(ax * ax + dy * dy)
                x0, y0, z0 = true_position(
                    ax - _PROBE * ax / there, ay - _PROBE * dy / there, az, medium, frame
                )
                length = np.sqrt((x - x0) ** 2 + (y - y0) ** 2 + z0 * z0)
                node[12] = (x - x0) / length
                node[13] = (y - y0) / length
                node[14] = -z0 / length


@njit(**INNER)
def look_up(x, y, z, view, frame, node):  # type: ignore[no-untyped-def]
    """Return a point's apparent position in F, in m; write the (15,) interpolated node."""
    table = view.table
    dy = y + view.centre_offset
    r = np.sqrt(x * x + dy * dy)
    u = np.arctan2(x, dy) * view.angles_per_radian + view.middle
    v = (r - view.nearest) * view.depths_per_metre
    u = min(max(u, 0.0), table.shape[1] - 1.001)
    v = min(max(v, 0.0), table.shape[2] - 1.001)
    j = np.int64(u)
    k = np.int64(v)
    a = u - j
    b = v - k
    for i in range(15):
        node[i] = (1 - a) * (
            (1 - b) * table[frame, j, k, i] + b * table[frame, j, k + 1, i]
        ) + a * ((1 - b) * table[frame, j + 1, k, i] + b * table[frame, j + 1, k + 1, i])
    return x + node[0] + node[5] * z, y + node[1] + node[8] * z, node[2] + node[11] * z


@njit(**OPTIONS)
def apparent_shaft(shaft, X_FT, view, frame, spacing):  # type: ignore[no-untyped-def]
    """Return apparent positions in T of points along an (m, 3) shaft in T; see `spaced`."""
    points = spaced(shaft, spacing)
    node = np.empty(15)
    for i in range(len(points)):
        x, y, z = transformed(X_FT, points[i, 0], points[i, 1], points[i, 2])
        x, y, z = look_up(x, y, z, view, frame, node)
        x -= X_FT[0, 3]
        y -= X_FT[1, 3]
        z -= X_FT[2, 3]
        for axis in range(3):
            points[i, axis] = X_FT[0, axis] * x + X_FT[1, axis] * y + X_FT[2, axis] * z
    return points


@njit(**OPTIONS)
def integrate_paths(gains, delays, X_TF, medium, paths, line_pitch, twist):  # type: ignore[no-untyped-def]
    """Write (frames, lines, nodes) gains and delays along lines.

    Gains are factors on the amplitude of echoes, delays paths in m by which they appear deeper;
    ``paths`` are `PathLabels`, line_pitch and twist angles in rad from one line to the next.
    """
    frames, lines, nodes = gains.shape
    origin, per_metre = paths.origin, 1 / paths.spacing
    nx, ny, nz = paths.labels.shape
    step = 1 / medium.nodes_per_metre
    for frame in range(frames):
        X = X_TF[frame]
        bends = medium.offsets[frame] > -1e6
        for j in range(lines):
            from_middle = j - 0.5 * (lines - 1)
            sine = np.sin(line_pitch * from_middle)
            cosine = np.cos(line_pitch * from_middle)
            loss = 0.0
            late = 0.0
            for k in range(nodes):
                gains[frame, j, k] = np.exp(-loss)
                delays[frame, j, k] = late
                r = medium.array_radius + (k + 0.5) * step
                y = r * cosine - medium.centre_offset
                x = r * sine
                z = y * twist * from_middle
                if bends:
                    x, y, z = true_position(x, y, z, medium, frame)
                a = per_metre * (_coordinate(X, 0, x, y, z) - origin[0])
                b = per_metre * (_coordinate(X, 1, x, y, z) - origin[1])
                c = per_metre * (_coordinate(X, 2, x, y, z) - origin[2])
                if 0 <= a < nx and 0 <= b < ny and 0 <= c < nz:
                    label = paths.labels[np.int64(a), np.int64(b), np.int64(c)]
                    loss += paths.loss_rate[label] * step
                    late += paths.delay_rate[label] * step


@njit(**INNER)
def _coordinate(X, axis, x, y, z):  # type: ignore[no-untyped-def]
    """Return one coordinate of a transformed point."""
    return X[axis, 0] * x + X[axis, 1] * y + X[axis, 2] * z + X[axis, 3]
