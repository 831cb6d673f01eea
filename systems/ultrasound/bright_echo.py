"""Echoes of bright points: needles and inclusions, with the shadow of the former."""

from typing import NamedTuple

import numpy as np
from numba import njit

from sonoservo.systems.ultrasound.echo import FRACTIONS, OPTIONS, REACH, line_coordinates, phasor

SIDE_LOBE_LEVEL = 10 ** (-30 / 20)
"""Amplitude of the side lobes, a second, wider Gaussian, relative to the main lobe."""

SIDE_LOBE_WIDTH = 3.0
"""Width of the side lobes over the main lobe's."""


class NeedleEcho(NamedTuple):
    """What a needle's points echo."""

    spacing: float
    """Between points along the shaft, in m."""
    specular: float
    """Amplitude of each point, all in phase."""
    diffuse: float
    """Amplitude of each point, in phases that the needle's surface fixes."""
    tip: float
    """Amplitude of the tip."""
    shadow: float
    """Share of the amplitude that a needle in the middle of the beam takes away behind it."""


@njit(**OPTIONS)
def add_point(  # type: ignore[no-untyped-def]
    iq, shadow, x, y, z, closer, real, imaginary, shadow_strength, rays, tables, pulse
):
    """Add the echo of one bright point in F to the samples of a frame.

    Parameters
    ----------
    iq
        (lines, samples) complex64, added to.
    shadow
        (lines, samples) float32: greatest loss that begins at each sample; (0, 0) for none.
    x, y, z, closer
        Position in F, and how much closer than that the reflecting surface is, in m.
    real, imaginary
        Amplitude of the point.
    shadow_strength
        Loss in the middle of the beam.
    rays, tables, pulse
        Of the frame; pulse is (FRACTIONS + 1, taps) complex64 and begins ``rays.lead`` samples
        before the echo.
    """
    lines, samples = iq.shape
    line, e, r = line_coordinates(x, y, z, rays)
    depth = r - rays.array_radius
    at = np.int64(depth * rays.samples_per_metre + 0.5)
    if at < 0 or at >= samples:
        return
    u = tables.elevation_precision[at] * e * e
    furthest = REACH**2 / 2 * SIDE_LOBE_WIDTH**2
    if u > furthest:
        return
    path = depth + 0.5 * tables.curvature[at] * e * e - closer
    sample = path * rays.samples_per_metre
    k = np.int64(np.floor(sample))
    fraction = np.int64((sample - k) * FRACTIONS + 0.5)
    c, s = phasor(np.float32(path * rays.turns_per_metre))
    start = k - rays.lead
    bright = tables.bright[at]
    amplitude = bright * complex(real * c + imaginary * s, imaginary * c - real * s)
    precision = 0.5 / (tables.line_sigma[at] * tables.line_sigma[at])
    reach = np.sqrt((furthest - u) / precision)
    first = max(np.int64(np.ceil(line - reach)), 0)
    last = min(np.int64(np.floor(line + reach)), lines - 1)
    for j in range(first, last + 1):
        distance = u + precision * (j - line) * (j - line)
        main = np.exp(-distance)
        weight = main + SIDE_LOBE_LEVEL * np.exp(-distance / SIDE_LOBE_WIDTH**2)
        a = np.complex64(weight * amplitude)
        for tap in range(max(0, -start), min(pulse.shape[1], samples - start)):
            iq[j, start + tap] += a * pulse[fraction, tap]
        if shadow.size > 0 and k < samples:
            shadow[j, max(k, 0)] = max(shadow[j, max(k, 0)], np.float32(shadow_strength * main))


@njit(**OPTIONS)
def add_points(iq, X_FT, points, amplitudes, rays, tables, pulse):  # type: ignore[no-untyped-def]
    """Add inclusions: (n, 3) points in T with (n,) complex amplitudes."""
    no_shadow = np.empty((0, 0), np.float32)
    for i in range(len(points)):
        x = X_FT[0, 3]
        y = X_FT[1, 3]
        z = X_FT[2, 3]
        for axis in range(3):
            x += X_FT[0, axis] * points[i, axis]
            y += X_FT[1, axis] * points[i, axis]
            z += X_FT[2, axis] * points[i, axis]
        real = amplitudes[i].real
        imaginary = amplitudes[i].imag
        add_point(iq, no_shadow, x, y, z, 0.0, real, imaginary, 0.0, rays, tables, pulse)


@njit(**OPTIONS)
def add_needle(  # type: ignore[no-untyped-def]
    iq, shadow, X_FT, shaft, radius, echo, phases, rays, tables, pulse
):
    """Add the echo of a needle, point by point from the tip to the entry.

    Parameters
    ----------
    iq, shadow
        See `add_point`.
    X_FT
        (3, 4) pose of the tissue in F.
    shaft
        (m, 3) points of the axis in T, entry first.
    radius
        The sound is reflected by the front wall, this much closer than the axis, in m.
    echo
        `NeedleEcho`.
    phases
        (n,) phase of each diffuse point in rad, tip first; used periodically.
    rays, tables, pulse
        Of the frame.
    """
    number = 0
    along = 0.0
    for segment in range(len(shaft) - 1, 0, -1):
        dx = shaft[segment - 1, 0] - shaft[segment, 0]
        dy = shaft[segment - 1, 1] - shaft[segment, 1]
        dz = shaft[segment - 1, 2] - shaft[segment, 2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        while along <= length and length > 0:
            px = shaft[segment, 0] + dx * along / length
            py = shaft[segment, 1] + dy * along / length
            pz = shaft[segment, 2] + dz * along / length
            x = X_FT[0, 0] * px + X_FT[0, 1] * py + X_FT[0, 2] * pz + X_FT[0, 3]
            y = X_FT[1, 0] * px + X_FT[1, 1] * py + X_FT[1, 2] * pz + X_FT[1, 3]
            z = X_FT[2, 0] * px + X_FT[2, 1] * py + X_FT[2, 2] * pz + X_FT[2, 3]
            phase = phases[number % len(phases)]
            real = echo.specular + echo.diffuse * np.cos(phase)
            imaginary = echo.diffuse * np.sin(phase)
            if number == 0:
                real += echo.tip
            add_point(
                iq, shadow, x, y, z, radius, real, imaginary, echo.shadow, rays, tables, pulse
            )
            number += 1
            along += echo.spacing
        along -= length
