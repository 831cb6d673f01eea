"""Echoes of bright points: needles with their shadows, and inclusions."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    displace,
    frame_field,
)
from sonoservo.systems.ultrasound.simulation.kernels.medium import look_up
from sonoservo.systems.ultrasound.simulation.kernels.projection import (
    FRACTIONS,
    line_coordinates,
    phasor,
    transformed,
)

SIDE_LOBE_WIDTH = 3
"""Ratio of the width of the side lobes, a second Gaussian, to that of the main lobe."""

_FURTHEST = (2.0 * SIDE_LOBE_WIDTH) ** 2 / 2
"""Side lobes end at two of their standard deviations, 17 dB below their middle."""


class NeedleEcho(NamedTuple):
    """Amplitudes of a needle's points."""

    spacing: float
    """Distance between points along the shaft, in m."""
    specular: float
    """Amplitude of each point, all in phase."""
    diffuse: float
    """Amplitude of each point, with phases fixed by the needle's surface."""
    tip: float
    """Amplitude of all points of the bevel together."""
    bevel: float
    """Ratio of the bevel's length to the needle's radius."""
    shadow: float
    """Share of the amplitude that is lost behind a needle in the middle of the beam."""


class NeedleView(NamedTuple):
    """Factors on a needle's echo in every frame, which vary along it, with angle and in time."""

    specular: NDArray[np.float64]
    """(frames, nodes) factors on the specular amplitude along the shaft, from the tip."""
    diffuse: NDArray[np.float64]
    """(frames, nodes) factors on the diffuse amplitude."""
    tips: NDArray[np.float64]
    """(frames,) factors on the tip's amplitude."""
    points_per_node: float
    dimple: float
    """Amplitude of a dimple."""
    dimple_step: int
    """Number of points from one dimple to the next."""
    dimpled: int
    """Number of points behind the tip in the dimpled part."""


NO_NEEDLE_VIEW = NeedleView(np.empty((0, 0)), np.empty((0, 0)), np.empty(0), 1.0, 0.0, 1, 0)
"""Factors on the echo of a needle that looks the same from every angle at any time."""


@njit(**OPTIONS)
def _add_point(  # type: ignore[no-untyped-def]
    layer, shadow, x, y, z, closer, real, imaginary, shadow_strength, rays, tables, pulse
):
    """Add the echo of one bright point in F; return True if the frame sees it.

    Parameters
    ----------
    layer
        (2, lines, samples + 2 taps) float32 real and imaginary parts, added to.
    shadow
        (lines, samples) float32 greatest loss that begins at each sample; (0, 0) for no shadow.
    x, y, z, closer
        Position in F, and the distance by which the reflecting surface is closer, in m.
    real, imaginary
        Amplitude of the point.
    shadow_strength
        Loss in the middle of the beam.
    rays, tables
        Quantities of the frame's lines and of each depth.
    pulse
        (2, FRACTIONS + 1, taps) float32 real and imaginary parts; it begins ``rays.lead`` samples
        before the echo.
    """
    lines = layer.shape[1]
    taps = pulse.shape[2]
    samples = layer.shape[2] - 2 * taps
    line, e, r = line_coordinates(x, y, z, rays)
    depth = r - rays.array_radius
    at = np.int64(depth * rays.samples_per_metre + 0.5)
    if at < 0 or at >= samples:
        return False
    u = tables.elevation_precision[at] * e * e
    if u > _FURTHEST:
        return False
    path = depth + 0.5 * tables.curvature[at] * e * e - closer
    sample = path * rays.samples_per_metre
    k = np.int64(sample)
    if sample < 0 or k >= samples:
        return False
    fraction = np.int64((sample - k) * FRACTIONS + 0.5)
    c, s = phasor(np.float32(path * rays.turns_per_metre))
    bright = tables.bright[at]
    re = np.float32(bright * (real * c + imaginary * s))
    im = np.float32(bright * (imaginary * c - real * s))
    precision = 0.5 / (tables.line_sigma[at] * tables.line_sigma[at])
    reach = np.sqrt((_FURTHEST - u) / precision)
    first = np.int64(max(np.ceil(line - reach), 0.0))
    last = np.int64(min(np.floor(line + reach), lines - 1.0))
    start = k - rays.lead + taps
    for j in range(first, last + 1):
        distance = u + precision * (j - line) * (j - line)
        wide = np.exp(-distance / SIDE_LOBE_WIDTH**2)
        # Side lobes are in quadrature, which leaves the main lobe's coherent sum unchanged.
        main = np.float32(wide ** (SIDE_LOBE_WIDTH**2))
        side = np.float32(rays.side_lobes * wide)
        a = main * re - side * im
        b = main * im + side * re
        for tap in range(taps):
            layer[0, j, start + tap] += a * pulse[0, fraction, tap] - b * pulse[1, fraction, tap]
        for tap in range(taps):
            layer[1, j, start + tap] += a * pulse[1, fraction, tap] + b * pulse[0, fraction, tap]
        if shadow.size > 0:
            shadow[j, k] = max(shadow[j, k], np.float32(shadow_strength) * main)
    return first <= last


@njit(**OPTIONS)
def render_points(  # type: ignore[no-untyped-def]
    iq, X_FT, points, amplitudes, rays, tables, pulse, view, fields
):
    """Add inclusions to every frame.

    Parameters
    ----------
    iq
        (frames, lines, samples) complex64, added to.
    X_FT
        (frames, 3, 4) poses of the tissue in each frame's F.
    points, amplitudes
        (n, 3) positions in T and (n,) complex amplitudes.
    rays, tables, pulse
        See `_add_point`.
    view
        Apparent positions of points, or `NO_VIEW`.
    fields
        Displacements of the tissue, or `NO_DISPLACEMENTS`.
    """
    frames, lines, samples = iq.shape
    taps = pulse.shape[2]
    # Most points are further from a frame's plane than its beam is wide anywhere.
    furthest = rays.array_radius + samples / rays.samples_per_metre
    slab = np.sqrt(_FURTHEST / tables.elevation_precision.min())
    slab += abs(rays.twist) * rays.middle_line * furthest
    bends, deforms = len(view.table) > 0, len(fields.counts) > 0
    slab += view.furthest + fields.deepest + fields.widest_push
    for frame in range(frames):
        layer = np.zeros((2, lines, samples + 2 * taps), np.float32)
        no_shadow = np.empty((0, 0), np.float32)
        node = np.empty(15)
        F = np.empty((3, 3))
        field = frame_field(fields, frame)
        seen = False
        for i in range(len(points)):
            x, y, z = transformed(X_FT[frame], points[i, 0], points[i, 1], points[i, 2])
            if abs(z) > slab:
                continue
            if deforms:
                x, y, z = displace(points[i, 0], points[i, 1], points[i, 2], field, True, F)
                x, y, z = transformed(X_FT[frame], x, y, z)
            if bends:
                x, y, z = look_up(x, y, z, view, frame, node)
            re = amplitudes[i].real
            im = amplitudes[i].imag
            seen |= _add_point(layer, no_shadow, x, y, z, 0.0, re, im, 0.0, rays, tables, pulse)
        if seen:
            _add_layer(iq[frame], layer, taps)


@njit(**OPTIONS)
def render_needles(  # type: ignore[no-untyped-def]
    iq, X_FT, shafts, starts, radius, echo, phases, rays, tables, pulse, view, transmission
):
    """Add the needle to every frame, with its shadow.

    Parameters
    ----------
    iq
        (frames, lines, samples) complex64, changed.
    X_FT
        (frames, 3, 4) poses of the tissue in each frame's F.
    shafts, starts
        (m, 3) points in T on the needle's axis, entry first, of all frames together, and
        (frames + 1,) indices of each frame's first point.
    radius, echo, phases, rays, tables, pulse, view
        See `_add_needle`.
    transmission
        (frames, lines, samples) float32 factors on echoes from behind structures; empty if
        there are none.
    """
    frames, lines, samples = iq.shape
    taps = pulse.shape[2]
    for frame in range(frames):
        shaft = shafts[starts[frame] : starts[frame + 1]]
        if len(shaft) > 1:
            layer = np.zeros((2, lines, samples + 2 * taps), np.float32)
            shadow = np.zeros((lines, samples), np.float32)
            if _add_needle(
                layer,
                shadow,
                X_FT[frame],
                shaft,
                radius,
                echo,
                phases,
                rays,
                tables,
                pulse,
                view,
                frame,
            ):
                _cast_shadow(iq[frame], shadow)
                if len(transmission) > 0:
                    _weaken_layer(layer, transmission[frame], taps)
                _add_layer(iq[frame], layer, taps)


@njit(**OPTIONS)
def _add_needle(  # type: ignore[no-untyped-def]
    layer, shadow, X_FT, shaft, radius, echo, phases, rays, tables, pulse, view, frame
):
    """Add the echo of a needle, point by point from the tip; return True if any point shows.

    Parameters
    ----------
    layer, shadow
        See `_add_point`.
    X_FT
        (3, 4) pose of the tissue in F.
    shaft
        (m, 3) points of the axis in T, entry first.
    radius
        Radius of the needle, in m. The front wall, which reflects the sound, is closer than the
        axis by this distance.
    echo
        Amplitudes of the needle's points.
    phases
        (n,) phases of the diffuse points in rad, tip first; used periodically.
    rays, tables, pulse
        See `_add_point`.
    view, frame
        Factors on the echo, or `NO_NEEDLE_VIEW`, and the frame's number.
    """
    bevel_points = max(int(echo.bevel * radius / echo.spacing), 1)
    bevel = echo.tip / np.sqrt(bevel_points)
    varies = len(view.tips) > 0
    if varies:
        bevel *= view.tips[frame]
    number = 0
    along = 0.0
    seen = False
    for segment in range(len(shaft) - 1, 0, -1):
        dx = shaft[segment - 1, 0] - shaft[segment, 0]
        dy = shaft[segment - 1, 1] - shaft[segment, 1]
        dz = shaft[segment - 1, 2] - shaft[segment, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        while along <= length and length > 0:
            share = along / length
            x, y, z = transformed(
                X_FT,
                shaft[segment, 0] + share * dx,
                shaft[segment, 1] + share * dy,
                shaft[segment, 2] + share * dz,
            )
            # Along the bevel the wall tapers off, and the bevel's face scatters.
            wall = min((number + 0.5) / bevel_points, 1.0)
            if not varies:
                specular = wall * echo.specular
                diffuse = wall * echo.diffuse + (bevel if number < bevel_points else 0.0)
            else:
                node = min(np.int64(number / view.points_per_node), view.specular.shape[1] - 1)
                specular = wall * echo.specular * view.specular[frame, node]
                diffuse = wall * echo.diffuse * view.diffuse[frame, node]
                if number < bevel_points:
                    diffuse += bevel
                elif number < view.dimpled and number % view.dimple_step == 0:
                    diffuse += view.dimple
            phase = phases[number % len(phases)]
            real = specular + diffuse * np.cos(phase)
            imaginary = diffuse * np.sin(phase)
            seen |= _add_point(
                layer, shadow, x, y, z, radius, real, imaginary, echo.shadow, rays, tables, pulse
            )
            number += 1
            along += echo.spacing
        along -= length
    return seen


@njit(**OPTIONS)
def _cast_shadow(iq, shadow):  # type: ignore[no-untyped-def]
    """Weaken the (lines, samples) echoes that lie in the (lines, samples) shadow."""
    for j in range(iq.shape[0]):
        loss = np.float32(0)
        for i in range(iq.shape[1]):
            iq[j, i] *= np.float32(1) - loss
            loss = max(loss, shadow[j, i])


@njit(**OPTIONS)
def _weaken_layer(layer, transmission, taps):  # type: ignore[no-untyped-def]
    """Weaken a layer by a frame's (lines, samples) transmission."""
    for j in range(transmission.shape[0]):
        for i in range(transmission.shape[1]):
            layer[0, j, i + taps] *= transmission[j, i]
            layer[1, j, i + taps] *= transmission[j, i]


@njit(**OPTIONS)
def _add_layer(iq, layer, taps):  # type: ignore[no-untyped-def]
    """Add a layer of bright points to a frame's (lines, samples) complex64 echoes."""
    for j in range(iq.shape[0]):
        for i in range(iq.shape[1]):
            iq[j, i] += complex(layer[0, j, i + taps], layer[1, j, i + taps])
