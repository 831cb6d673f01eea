"""Pieces of surfaces, and where a frame sees them."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER
from sonoservo.systems.ultrasound.simulation.kernels.blocks import misses
from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    displace,
    displacement_limit,
    limit_along,
)
from sonoservo.systems.ultrasound.simulation.kernels.medium import largest_aside, look_up
from sonoservo.systems.ultrasound.simulation.kernels.projection import transformed

_AWAY = 0.02
_LEAST_SLACK = 1e-4


class Pieces(NamedTuple):
    """Pieces of surfaces."""

    points: NDArray[np.float64]
    """(n, 3) positions in T, in m."""
    normals: NDArray[np.float64]
    """(n, 3) outward normals in T."""
    surfaces: NDArray[np.int64]
    """(n,) number of the surface that each piece belongs to."""
    specular: NDArray[np.float64]
    """(n,) specular amplitudes, all in phase."""
    diffuse: NDArray[np.complex128]
    """(n,) diffuse amplitudes, with phases fixed by the surface."""
    blocked: NDArray[np.float64]
    """(n,) areas in m^2 that let no sound through, both ways."""
    steps: NDArray[np.float64]
    """(n,) distances to the next piece, in m."""
    one_sided: NDArray[np.bool_]
    """(surfaces,) True if only the outer side reflects."""
    reverberation: NDArray[np.float64]
    """(surfaces,) amplitude of each echo by way of the face, relative to the previous one."""
    pulses: NDArray[np.int64]
    """(surfaces,) number of the pulse that follows the echo; 0 for none."""
    table: NDArray[np.float32]
    """(kinds (FRACTIONS + 1), widest) pulses: the echo, and those that may follow it."""
    widths: NDArray[np.int64]
    """(kinds,) widths of the pulses."""
    reaches: NDArray[np.float64]
    """(n,) shares of the beam's reach in elevation beyond which pieces neither show nor shade."""


@njit(**INNER)
def place_pieces(  # type: ignore[no-untyped-def]
    seen, places, sights, frame, field, rays, pieces, growth, reach, furthest, node, F
):
    """Find the pieces that a frame may see; return their number.

    Their numbers are written to (n,) ``seen``, and to (n, 4) ``places`` their apparent positions in
    F in m with the cosine of the sound's angle to the normal. ``growth`` are (surfaces,)
    displacements outwards, and ``reach`` is the (samples,) half width of the beam in elevation, in
    m, with its maximum; node (15,) and F (3, 3) are memory.
    """
    view, X_FT = sights.bent, sights.X_FT[frame]
    twist_per_radian = rays.twist * rays.lines_per_radian
    depth = rays.array_radius + len(reach) / rays.samples_per_metre
    slab = furthest + abs(rays.twist) * rays.middle_line * depth
    slab += _LEAST_SLACK + view.furthest + sights.fields.deepest + sights.fields.widest_push
    bend = largest_aside(view, frame)
    count = 0
    for i in range(len(pieces.points)):
        px = pieces.points[i, 0]
        py = pieces.points[i, 1]
        pz = pieces.points[i, 2]
        grown = abs(growth[pieces.surfaces[i]])
        if abs(X_FT[2, 0] * px + X_FT[2, 1] * py + X_FT[2, 2] * pz + X_FT[2, 3]) > slab + grown:
            continue
        limit = displacement_limit(px, py, pz, field)
        slack = _LEAST_SLACK + grown + view.furthest + limit
        aside = _LEAST_SLACK + grown + bend + limit_along(limit, X_FT[2, 2], field)
        x, y, z = transformed(X_FT, px, py, pz)
        share = pieces.reaches[i]
        if misses(x, y, z, slack, aside, reach, share, twist_per_radian, rays):
            continue
        if _is_turned_away(i, X_FT, pieces, rays):
            continue
        x, y, z, cosine = _in_frame(i, X_FT, pieces, growth, view, field, frame, node, F, rays)
        if cosine > 0 and pieces.one_sided[pieces.surfaces[i]]:
            continue
        seen[count] = i
        places[count, 0] = x
        places[count, 1] = y
        places[count, 2] = z
        places[count, 3] = cosine
        count += 1
    return count


@njit(**INNER)
def _is_turned_away(i, X_FT, pieces, rays):  # type: ignore[no-untyped-def]
    """Return True if a piece that reflects on one side only certainly faces away from the probe."""
    if not pieces.one_sided[pieces.surfaces[i]]:
        return False
    # The array's centre in T, from which the sound comes.
    ahead = 0.0
    for axis in range(3):
        centre = 0.0
        for other in range(3):
            origin = X_FT[other, 3] + (rays.centre_offset if other == 1 else 0.0)
            centre -= X_FT[other, axis] * origin
        ahead += (pieces.points[i, axis] - centre) * pieces.normals[i, axis]
    return ahead > _AWAY


@njit(**INNER)
def _in_frame(  # type: ignore[no-untyped-def]
    i, X_FT, pieces, growth, view, field, frame, node, F, rays
):
    """Return a piece's apparent position in F and the cosine of the sound's angle to its normal."""
    surface = pieces.surfaces[i]
    nx = pieces.normals[i, 0]
    ny = pieces.normals[i, 1]
    nz = pieces.normals[i, 2]
    x = pieces.points[i, 0] + growth[surface] * nx
    y = pieces.points[i, 1] + growth[surface] * ny
    z = pieces.points[i, 2] + growth[surface] * nz
    if field.depth > 0 or field.points > 1:
        x, y, z = displace(x, y, z, field, True, F)
        nx, ny, nz = _turned(nx, ny, nz, F)
    px = X_FT[0, 0] * x + X_FT[0, 1] * y + X_FT[0, 2] * z + X_FT[0, 3]
    py = X_FT[1, 0] * x + X_FT[1, 1] * y + X_FT[1, 2] * z + X_FT[1, 3]
    pz = X_FT[2, 0] * x + X_FT[2, 1] * y + X_FT[2, 2] * z + X_FT[2, 3]
    if len(view.table) == 0:
        q = py + rays.centre_offset
        r = np.sqrt(px * px + q * q)
        ux = px / r
        uy = q / r
        uz = 0.0
    else:
        px, py, pz = look_up(px, py, pz, view, frame, node)
        ux = node[12]
        uy = node[13]
        uz = node[14]
    fx = X_FT[0, 0] * nx + X_FT[0, 1] * ny + X_FT[0, 2] * nz
    fy = X_FT[1, 0] * nx + X_FT[1, 1] * ny + X_FT[1, 2] * nz
    fz = X_FT[2, 0] * nx + X_FT[2, 1] * ny + X_FT[2, 2] * nz
    return px, py, pz, fx * ux + fy * uy + fz * uz


@njit(**INNER)
def _turned(nx, ny, nz, F):  # type: ignore[no-untyped-def]
    """Return a surface's unit normal after a deformation with the gradient F (Nanson's formula)."""
    x = (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1]) * nx
    x += (F[1, 2] * F[2, 0] - F[1, 0] * F[2, 2]) * ny + (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0]) * nz
    y = (F[2, 1] * F[0, 2] - F[2, 2] * F[0, 1]) * nx
    y += (F[2, 2] * F[0, 0] - F[2, 0] * F[0, 2]) * ny + (F[2, 0] * F[0, 1] - F[2, 1] * F[0, 0]) * nz
    z = (F[0, 1] * F[1, 2] - F[0, 2] * F[1, 1]) * nx
    z += (F[0, 2] * F[1, 0] - F[0, 0] * F[1, 2]) * ny + (F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0]) * nz
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length
