"""Echoes of smooth surfaces, with shadow, reverberation and ring-down."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.kernels import OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.layers import (
    cast_shadows,
    empty_layer,
    join_layer,
    touch,
)
from sonoservo.systems.ultrasound.simulation.kernels.pieces import place_pieces
from sonoservo.systems.ultrasound.simulation.kernels.projection import (
    FRACTIONS,
    gaussian,
    line_coordinates,
    phasor,
)
from sonoservo.systems.ultrasound.simulation.kernels.vector_addition import add_pulse

FURTHEST = 3.0**2 / 2
"""Half the square of the standard deviations of the beam beyond which a piece has no effect."""

FAINT_PIECE = 0.08
"""Amplitude below which the tissue's echoes hide a piece's."""

SHADOW_REACH = 2.0
"""As `FURTHEST`, for the shadow of a piece too faint to show."""

_FAINTEST = 0.01
_NYQUIST_POWER = 8
_OWN_SHADOW = 2.5e-3


@njit(**OPTIONS)
def _add_piece(  # type: ignore[no-untyped-def]
    layer,
    place,
    times,
    specular,
    diffuse,
    blocked,
    step,
    rays,
    tables,
    pulses,
    widths,
    kind,
):
    """Add one piece's echo, or its echo after ``times`` round trips between face and surface.

    Parameters
    ----------
    layer
        `Layer`, added to.
    place
        (4,) apparent position in F in m, and the cosine of the sound's angle to the normal.
    times
        Number of round trips: 1 for the first echo, 2 for the next, and so on.
    specular, diffuse, blocked, step
        See `Pieces`.
    rays, tables, pulses, widths, kind
        See `render_surfaces`, and the pulse's number.
    """
    lines, samples = layer.loss.shape
    pad = (layer.echoes.shape[1] // 2 - samples) // 2
    line, e, r = line_coordinates(place[0], place[1], place[2], rays)
    depth = r - rays.array_radius
    at = np.int64(depth * rays.samples_per_metre + 0.5)
    if at < 0 or at >= samples:
        return
    precision_e = tables.elevation_precision[at]
    u = precision_e * e * e
    if u > FURTHEST:
        return
    path = times * (depth + 0.5 * tables.curvature[at] * e * e)
    sample = path * rays.samples_per_metre
    k = np.int64(sample)
    if sample < 0 or k >= samples:
        return
    # Echoes in phase from piece to piece produce the dependence on angle by themselves, as long as
    # the pieces are dense enough for the angle. Beyond it, specular sound has long vanished.
    sine = np.sqrt(max(1 - place[3] * place[3], 0.0))
    turns = 2 * times * rays.turns_per_metre * step * sine / 0.8
    squared = turns * turns
    smooth = np.exp(-(squared ** (_NYQUIST_POWER // 2)))
    row = kind * (FRACTIONS + 1) + np.int64((sample - k) * FRACTIONS + 0.5)
    width = widths[kind]
    c, s = phasor(np.float32(path * rays.turns_per_metre))
    bright = tables.bright[at]
    real = specular * smooth + diffuse.real
    re = np.float32(bright * (real * c + diffuse.imag * s))
    im = np.float32(bright * (diffuse.imag * c - real * s))
    # A piece's echo ends where the tissue's hides it; its shadow needs a smaller range.
    loudness = np.sqrt(re * re + im * im)
    furthest = min(np.log(loudness / FAINT_PIECE + 1e-9), FURTHEST)
    if blocked > 0:
        furthest = max(furthest, SHADOW_REACH)
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
    audible = loudness > 0.1 * FAINT_PIECE
    for j in range(first, last + 1):
        touch(layer, j, start, start + width // 2)
        main = gaussian(np.float32(u + precision * (j - line) * (j - line)))
        if audible:
            add_pulse(layer.echoes, j, start, pulses, row, width, main * re, main * im)
        if blocked > 0:
            layer.loss[j, k] += np.float32(share) * main


@njit(**OPTIONS)
def render_surfaces(  # type: ignore[no-untyped-def]
    iq, transmission, X_FT, pieces, growth, rays, tables, pulses, widths, view, fields, weakened
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
    pulses, widths
        (kinds (FRACTIONS + 1), widest) float32 pulses, and (kinds,) their widths. The first one is
        the echo; the others follow it.
    view
        Apparent positions of points, or `NO_VIEW`.
    fields
        Displacements of the tissue, or `NO_DISPLACEMENTS`.
    weakened
        Whether the transmission is initially below 1 anywhere.
    """
    reach = np.sqrt(FURTHEST / tables.elevation_precision)
    for frame in range(len(iq)):
        _render_frame(
            iq[frame],
            transmission[frame],
            X_FT[frame],
            pieces,
            growth[frame],
            reach,
            rays,
            tables,
            pulses,
            widths,
            view,
            fields,
            frame,
            weakened,
        )


@njit(**OPTIONS)
def _render_frame(  # type: ignore[no-untyped-def]
    iq,
    transmission,
    X_FT,
    pieces,
    growth,
    reach,
    rays,
    tables,
    pulses,
    widths,
    view,
    fields,
    frame,
    weakened,
):
    """Add surfaces to one frame; ``reach`` is the (samples,) half width of its beam in m."""
    lines, samples = iq.shape
    pad = pulses.shape[1] // 2
    seen = np.empty(len(pieces.points), np.int64)
    places = np.empty((len(pieces.points), 4))
    count = place_pieces(seen, places, X_FT, pieces, growth, reach, rays, view, fields, frame)
    if count == 0:
        if weakened:
            for j in range(lines):
                for i in range(samples):
                    iq[j, i] *= transmission[j, i]
        return
    layer = empty_layer(lines, samples, pad)
    for number in range(count):
        i = seen[number]
        facing = abs(places[number, 3])
        diffuse = pieces.diffuse[i] * facing
        blocked = pieces.blocked[i] * facing
        _add_piece(
            layer, places[number], 1.0, pieces.specular[i], diffuse, blocked,
            pieces.steps[i], rays, tables, pulses, widths, 0,
        )  # fmt: skip
    margin = np.int64(_OWN_SHADOW * rays.samples_per_metre)
    cast_shadows(transmission, layer, margin)
    for number in range(count):
        i = seen[number]
        surface = pieces.surfaces[i]
        level = pieces.reverberation[surface]
        kind = pieces.pulses[surface]
        if level == 0 and kind == 0:
            continue
        # Echoes after the first one are not in the surface's own shadow.
        diffuse = pieces.diffuse[i] * abs(places[number, 3]) if kind > 0 else 0j
        times = 1.0 if kind > 0 else 2.0
        again = 1.0 if kind > 0 else level
        while again > _FAINTEST:
            _add_piece(
                layer, places[number], times, pieces.specular[i] * again,
                diffuse, 0.0, pieces.steps[i], rays, tables, pulses, widths, kind,
            )  # fmt: skip
            if kind > 0:
                break
            again *= level
            times += 1
    join_layer(iq, transmission, layer, weakened)
