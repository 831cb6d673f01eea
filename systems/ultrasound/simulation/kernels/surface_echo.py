"""Echoes of smooth surfaces, with shadow, reverberation and ring-down."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from sonoservo.systems.sampling.options import OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    displace,
    displacement_limit,
)
from sonoservo.systems.ultrasound.simulation.kernels.medium import look_up
from sonoservo.systems.ultrasound.simulation.kernels.projection import (
    FRACTIONS,
    line_coordinates,
    phasor,
)
from sonoservo.systems.ultrasound.simulation.kernels.shadows import cast_shadows, join_layer

_FURTHEST = 3.0**2 / 2
_FAINTEST = 0.01
_NYQUIST_POWER = 8
_OWN_SHADOW = 2.5e-3
_FAINT_PIECE = 0.08
_SHADOW_REACH = 2.0
_AWAY = 0.02


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


@njit(**OPTIONS)
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


@njit(**OPTIONS)
def _in_frame(  # type: ignore[no-untyped-def]
    i, X_FT, pieces, growth, view, field, frame, node, F, G, rays
):
    """Return a piece's apparent position in F and the cosine of the sound's angle to its normal."""
    surface = pieces.surfaces[i]
    nx = pieces.normals[i, 0]
    ny = pieces.normals[i, 1]
    nz = pieces.normals[i, 2]
    x = pieces.points[i, 0] + growth[surface] * nx
    y = pieces.points[i, 1] + growth[surface] * ny
    z = pieces.points[i, 2] + growth[surface] * nz
    if len(field.counts) > 0:
        x, y, z = displace(x, y, z, field, frame, True, F, G)
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


@njit(**OPTIONS)
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


@njit(**OPTIONS)
def _add_piece(  # type: ignore[no-untyped-def]
    layer,
    loss,
    touched,
    x,
    y,
    z,
    times,
    specular,
    diffuse,
    blocked,
    step,
    sine,
    rays,
    tables,
    pulse,
):
    """Add one piece's echo, or its echo after ``times`` round trips between face and surface.

    Parameters
    ----------
    layer
        (2, lines, samples + 2 taps) float32, added to.
    loss
        (lines, samples) float32 shares of the amplitude that each sample takes from those behind
        it, added to; (0, 0) for none.
    touched
        (lines,) flags of the lines on which the layer or the loss changes, set.
    x, y, z
        Apparent position in F, in m.
    times
        Number of round trips: 1 for the first echo, 2 for the next, and so on.
    specular, diffuse, blocked, step
        See `Pieces`.
    sine
        Sine of the sound's angle to the normal.
    rays, tables, pulse
        See `bright_echo`.
    """
    lines = layer.shape[1]
    taps = pulse.shape[2]
    pad = (layer.shape[2] - tables.bright.size) // 2
    samples = layer.shape[2] - 2 * pad
    line, e, r = line_coordinates(x, y, z, rays)
    depth = r - rays.array_radius
    at = np.int64(depth * rays.samples_per_metre + 0.5)
    if at < 0 or at >= samples:
        return
    precision_e = tables.elevation_precision[at]
    u = precision_e * e * e
    if u > _FURTHEST:
        return
    path = times * (depth + 0.5 * tables.curvature[at] * e * e)
    sample = path * rays.samples_per_metre
    k = np.int64(sample)
    if sample < 0 or k >= samples:
        return
    # Echoes in phase from piece to piece produce the dependence on angle by themselves, as long as
    # the pieces are dense enough for the angle. Beyond it, specular sound has long vanished.
    turns = 2 * times * rays.turns_per_metre * step * sine / 0.8
    squared = turns * turns
    smooth = np.exp(-(squared ** (_NYQUIST_POWER // 2)))
    fraction = np.int64((sample - k) * FRACTIONS + 0.5)
    c, s = phasor(np.float32(path * rays.turns_per_metre))
    bright = tables.bright[at]
    real = specular * smooth + diffuse.real
    re = np.float32(bright * (real * c + diffuse.imag * s))
    im = np.float32(bright * (diffuse.imag * c - real * s))
    # A piece's echo ends where the tissue's hides it; its shadow needs a smaller range.
    loudness = np.sqrt(re * re + im * im)
    furthest = min(np.log(loudness / _FAINT_PIECE + 1e-9), _FURTHEST)
    if loss.size > 0 and blocked > 0:
        furthest = max(furthest, _SHADOW_REACH)
    if u > furthest:
        return
    sigma = tables.line_sigma[at]
    precision = 0.5 / (sigma * sigma)
    reach = np.sqrt((furthest - u) / precision)
    first = np.int64(max(np.ceil(line - reach), 0.0))
    last = np.int64(min(np.floor(line + reach), lines - 1.0))
    share = blocked * np.sqrt(precision_e * precision) / np.pi
    # Parts beyond the furthest count as within.
    share *= rays.lines_per_radian / max(r, 1e-3) / (1 - np.exp(-furthest))
    start = k - rays.lead + pad
    audible = loudness > 0.1 * _FAINT_PIECE
    for j in range(first, last + 1):
        touched[j] = True
        main = np.float32(np.exp(-u - precision * (j - line) * (j - line)))
        if audible:
            a = main * re
            b = main * im
            for tap in range(taps):
                layer[0, j, start + tap] += (
                    a * pulse[0, fraction, tap] - b * pulse[1, fraction, tap]
                )
            for tap in range(taps):
                layer[1, j, start + tap] += (
                    a * pulse[1, fraction, tap] + b * pulse[0, fraction, tap]
                )
        if loss.size > 0:
            loss[j, k] += np.float32(share) * main


@njit(parallel=True, **OPTIONS)
def render_surfaces(  # type: ignore[no-untyped-def]
    iq, transmission, X_FT, pieces, growth, rays, tables, pulses, taps, view, field, weakened
):
    """Add surfaces to every frame, and weaken the echoes behind them.

    Parameters
    ----------
    iq
        (frames, lines, samples) complex64, changed.
    transmission
        (frames, lines, samples) float32 factors on echoes from each sample, changed.
    X_FT
        (frames, 3, 4) poses of the tissue in each frame's F.
    pieces
        Pieces of the surfaces.
    growth
        (frames, surfaces) distances in m by which each surface is displaced outwards.
    rays, tables
        Quantities of the frames' lines and of each depth.
    pulses, taps
        (kinds, 2, FRACTIONS + 1, longest) float32 pulses, and (kinds,) their lengths. The first one
        is the echo; the others follow it.
    view
        Apparent positions of points, or `NO_VIEW`.
    field
        Displacements of the tissue, or `NO_DISPLACEMENTS`.
    weakened
        Whether the transmission is initially below 1 anywhere.
    """
    frames, lines, samples = iq.shape
    pad = pulses.shape[3]
    furthest = rays.array_radius + samples / rays.samples_per_metre
    slab = np.sqrt(_FURTHEST / tables.elevation_precision.min())
    slab += abs(rays.twist) * rays.middle_line * furthest
    slab += view.aside
    deforms = len(field.counts) > 0
    margin = np.int64(_OWN_SHADOW * rays.samples_per_metre)
    for each in prange(frames):
        frame = np.int64(each)
        X = X_FT[frame]
        seen = np.empty(len(pieces.points), np.int64)
        count = 0
        for i in range(len(pieces.points)):
            z = X[2, 0] * pieces.points[i, 0] + X[2, 1] * pieces.points[i, 1]
            z += X[2, 2] * pieces.points[i, 2] + X[2, 3]
            thick = slab
            if deforms and abs(z) < slab + field.deepest + field.widest_push:
                p = pieces.points[i]
                thick += displacement_limit(p[0], p[1], p[2], field, frame)
            if abs(z) < thick and not _is_turned_away(i, X, pieces, rays):
                seen[count] = i
                count += 1
        if count > 0:
            layer = np.zeros((2, lines, samples + 2 * pad), np.float32)
            loss = np.zeros((lines, samples), np.float32)
            no_loss = np.empty((0, 0), np.float32)
            touched = np.zeros(lines, np.bool_)
            node, F, G = np.empty(15), np.empty((3, 3)), np.empty((3, 3))
            for number in range(count):
                i = seen[number]
                surface = pieces.surfaces[i]
                x, y, z, cosine = _in_frame(
                    i, X, pieces, growth[frame], view, field, frame, node, F, G, rays
                )
                if cosine > 0 and pieces.one_sided[surface]:
                    continue
                sine = np.sqrt(max(1 - cosine * cosine, 0.0))
                _add_piece(
                    layer,
                    loss,
                    touched,
                    x,
                    y,
                    z,
                    1.0,
                    pieces.specular[i],
                    pieces.diffuse[i] * abs(cosine),
                    pieces.blocked[i] * abs(cosine),
                    pieces.steps[i],
                    sine,
                    rays,
                    tables,
                    pulses[0, :, :, : taps[0]],
                )
            cast_shadows(transmission[frame], layer, loss, touched, margin, pad)
            for number in range(count):
                i = seen[number]
                surface = pieces.surfaces[i]
                level = pieces.reverberation[surface]
                kind = pieces.pulses[surface]
                if level == 0 and kind == 0:
                    continue
                x, y, z, cosine = _in_frame(
                    i, X, pieces, growth[frame], view, field, frame, node, F, G, rays
                )
                if cosine > 0 and pieces.one_sided[surface]:
                    continue
                sine = np.sqrt(max(1 - cosine * cosine, 0.0))
                # Echoes after the first one are not in the surface's own shadow.
                diffuse = pieces.diffuse[i] * abs(cosine) if kind > 0 else 0j
                times = 1.0 if kind > 0 else 2.0
                again = 1.0 if kind > 0 else level
                while again > _FAINTEST:
                    _add_piece(
                        layer,
                        no_loss,
                        touched,
                        x,
                        y,
                        z,
                        times,
                        pieces.specular[i] * again,
                        diffuse,
                        0.0,
                        pieces.steps[i],
                        sine,
                        rays,
                        tables,
                        pulses[kind, :, :, : taps[kind]],
                    )
                    if kind > 0:
                        break
                    again *= level
                    times += 1
            join_layer(iq[frame], transmission[frame], layer, touched, weakened, pad)
        elif weakened:
            iq[frame] *= transmission[frame]
