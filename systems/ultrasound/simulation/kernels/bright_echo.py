"""Echoes of bright points: inclusions, and the points of needles."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    displace,
    frame_field,
)
from sonoservo.systems.ultrasound.simulation.kernels.layers import add_layer, empty_layer, touch
from sonoservo.systems.ultrasound.simulation.kernels.medium import look_up
from sonoservo.systems.ultrasound.simulation.kernels.projection import bright_echo, transformed
from sonoservo.systems.ultrasound.simulation.kernels.vector_addition import add_pulse

SIDE_LOBE_WIDTH = 3
"""Ratio of the width of the side lobes, a second Gaussian, to that of the main lobe."""

_FURTHEST = (2.0 * SIDE_LOBE_WIDTH) ** 2 / 2
"""Side lobes end at two of their standard deviations, 17 dB below their middle."""

ELEVATION_LOBES = (10 ** (-30 / 20), 4.5)
"""Level and width of the side lobes in elevation, relative to the main lobe's.

One row of elements is an aperture with equal weights, whose two-way beam at the focus is sinc^2.
Its lobes, -26.5 dB at 3.8, -35.7 dB at 6.5 and -41.6 dB at 9.2 standard deviations, have a Gaussian
of this width and -26.4 dB as their root mean square. A short pulse has lobes 4 dB weaker (PyMUST).
"""

_ELEVATION_WIDENING = ELEVATION_LOBES[1] ** 2
_FURTHEST_OUT = 2.0 * _ELEVATION_WIDENING
_MAIN_REACH = 4.5


@njit(**INNER)
def add_point(layer, rays, pulse, place, closer, amplitude, shadow):  # type: ignore[no-untyped-def]
    """Add the echo of one bright point in F to a `Layer`; return True if the frame sees it.

    The reflecting surface is closer than the point by ``closer`` m; ``shadow`` is the loss in the
    middle of the beam, of which a layer keeps the greatest.
    """
    lines, taps = len(layer.loss), pulse.shape[1] // 2
    k, fraction, line, _, at, u, c, s = bright_echo(rays, place, 1, closer, _FURTHEST_OUT)
    if k < 0:
        return False
    bright = rays.bright[at]
    re = np.float32(bright * (amplitude.real * c + amplitude.imag * s))
    im = np.float32(bright * (amplitude.imag * c - amplitude.real * s))
    precision = 0.5 / (rays.line_sigma[at] * rays.line_sigma[at])
    reach = np.sqrt(max(_FURTHEST - u, _MAIN_REACH) / precision)
    middle = np.exp(-u)
    near = rays.side_lobes * np.exp(-u / SIDE_LOBE_WIDTH**2)
    far = rays.elevation_lobes * np.exp(-u / _ELEVATION_WIDENING)
    first = np.int64(max(np.ceil(line - reach), 0.0))
    last = np.int64(min(np.floor(line + reach), lines - 1.0))
    start = k - rays.lead + taps
    for j in range(first, last + 1):
        wide = np.exp(-precision * (j - line) * (j - line) / SIDE_LOBE_WIDTH**2)
        narrow = wide ** (SIDE_LOBE_WIDTH**2)
        # Side lobes are in quadrature, which leaves the main lobe's coherent sum unchanged.
        main = np.float32(narrow * middle)
        side = np.float32(near * wide + far * narrow)
        a = main * re - side * im
        b = main * im + side * re
        add_pulse(layer.echoes, j, start, pulse, fraction, 2 * taps, a, b)
        touch(layer, j, start, start + taps)
        if shadow > 0:
            layer.loss[j, k] = max(layer.loss[j, k], np.float32(shadow) * main)
    return first <= last


@njit(**OPTIONS)
def seen_within(rays):  # type: ignore[no-untyped-def]
    """Return the distance in m from a frame's plane beyond which no point shows in any line."""
    furthest = rays.array_radius + rays.bright.size / rays.samples_per_metre
    least = np.inf  # a method of the array would count references
    for precision in rays.elevation_precision:
        least = min(least, precision)
    reach = np.sqrt(_FURTHEST_OUT / least)
    return reach + abs(rays.twist) * rays.middle_line * furthest


@njit(**OPTIONS)
def render_points(iq, sights, rays, points, amplitudes, pulse):  # type: ignore[no-untyped-def]
    """Add inclusions, (n, 3) in T and (n,) complex, to (frames, lines, samples) echoes."""
    frames, lines, samples = iq.shape
    node, F = np.empty(15), np.empty((3, 3))
    slab = seen_within(rays) + sights.bent.furthest
    slab += sights.fields.deepest + sights.fields.widest_push
    layer = empty_layer(lines, samples, pulse.shape[1] // 2)
    for frame in range(frames):
        field = frame_field(sights.fields, frame)
        if _add_points(layer, sights, frame, field, rays, slab, points, amplitudes, pulse, node, F):
            add_layer(iq[frame], layer)


@njit(**INNER)
def _add_points(  # type: ignore[no-untyped-def]
    layer, sights, frame, field, rays, slab, points, amplitudes, pulse, node, F
):
    """Add inclusions to a frame's layer; return True if it sees any.

    None is seen beyond the slab's half width in m; node (15,) and F (3, 3) are memory.
    """
    view, X_FT = sights.bent, sights.X_FT[frame]
    bends, deforms = len(view.table) > 0, len(sights.fields.counts) > 0
    seen = False
    for i in range(len(points)):
        x, y, z = transformed(X_FT, points[i, 0], points[i, 1], points[i, 2])
        if abs(z) > slab:
            continue
        if deforms:
            x, y, z = displace(points[i, 0], points[i, 1], points[i, 2], field, True, F)
            x, y, z = transformed(X_FT, x, y, z)
        if bends:
            x, y, z = look_up(x, y, z, view, frame, node)
        seen |= add_point(layer, rays, pulse, (x, y, z), 0.0, amplitudes[i], 0.0)
    return seen
