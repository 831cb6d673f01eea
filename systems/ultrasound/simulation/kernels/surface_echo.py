"""Echoes of smooth surfaces, with shadow, reverberation and ring-down."""

import numpy as np
from numba import njit

from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.displacement import frame_field
from sonoservo.systems.ultrasound.simulation.kernels.layers import (
    cast_shadows,
    empty_layer,
    join_layer,
    touch,
)
from sonoservo.systems.ultrasound.simulation.kernels.pieces import place_pieces
from sonoservo.systems.ultrasound.simulation.kernels.projection import (
    FRACTIONS,
    bright_echo,
    gaussian,
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


@njit(**INNER)
def _add_piece(layer, rays, pieces, i, place, times, level, kind):  # type: ignore[no-untyped-def]
    """Add piece i's echo, or its echo after ``times`` round trips between face and surface.

    ``place`` is its apparent position in F in m, with the cosine of the sound's angle to the
    normal; ``level`` that of this echo relative to the first, and ``kind`` the number of its pulse.
    """
    first = times == 1 and kind == 0
    facing = abs(place[3])
    specular = pieces.specular[i] * level
    # Echoes after the first one are not in the surface's own shadow.
    diffuse = pieces.diffuse[i] * facing if times == 1 else 0j
    blocked = pieces.blocked[i] * facing if first else 0.0
    step = pieces.steps[i]
    lines, samples = layer.loss.shape
    pad = (layer.echoes.shape[1] // 2 - samples) // 2
    k, fraction, line, r, at, u, c, s = bright_echo(rays, place, times, 0.0, FURTHEST)
    if k < 0:
        return
    # Echoes in phase from piece to piece produce the dependence on angle by themselves, as long as
    # the pieces are dense enough for the angle. Beyond it, specular sound has long vanished.
    sine = np.sqrt(max(1 - place[3] * place[3], 0.0))
    turns = 2 * times * rays.turns_per_metre * step * sine / 0.8
    squared = turns * turns
    smooth = np.exp(-(squared ** (_NYQUIST_POWER // 2)))
    row = kind * (FRACTIONS + 1) + fraction
    width = pieces.widths[kind]
    bright = rays.bright[at]
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
    sigma = rays.line_sigma[at]
    precision = 0.5 / (sigma * sigma)
    reach = np.sqrt((furthest - u) / precision)
    lowest = np.int64(max(np.ceil(line - reach), 0.0))
    highest = np.int64(min(np.floor(line + reach), lines - 1.0))
    share = blocked * np.sqrt(rays.elevation_precision[at] * precision) / np.pi
    # Parts beyond the furthest count as within.
    share *= rays.lines_per_radian / max(r, 1e-3) / (1 - np.exp(-furthest))
    start = k - rays.lead + pad
    audible = loudness > 0.1 * FAINT_PIECE
    for j in range(lowest, highest + 1):
        touch(layer, j, start, start + width // 2)
        main = gaussian(np.float32(u + precision * (j - line) * (j - line)))
        if audible:
            add_pulse(layer.echoes, j, start, pieces.table, row, width, main * re, main * im)
        if blocked > 0:
            layer.loss[j, k] += np.float32(share) * main


@njit(**OPTIONS)
def render_surfaces(iq, transmission, sights, rays, pieces, growth, weakened):  # type: ignore[no-untyped-def]
    """Add surfaces to every frame, and weaken the echoes behind them, in ``iq`` and transmission.

    ``growth`` are (frames, surfaces) distances in m by which surfaces are displaced outwards;
    ``weakened`` says that the transmission is below 1 somewhere from the start.
    """
    reach = np.sqrt(FURTHEST / rays.elevation_precision)
    seen = np.empty(len(pieces.points), np.int64)
    places = np.empty((len(pieces.points), 4))
    node, F = np.empty(15), np.empty((3, 3))
    layer = empty_layer(iq.shape[1], iq.shape[2], pieces.table.shape[1] // 2)
    for frame in range(len(iq)):
        field = frame_field(sights.fields, frame)
        count = place_pieces(
            seen, places, sights, frame, field, rays, pieces, growth[frame], reach, reach.max(),
            node, F,
        )  # fmt: skip
        if count > 0:
            _render_frame(
                iq[frame], transmission[frame], layer, rays, pieces, seen[:count], places, weakened
            )
        elif weakened:
            iq[frame] *= transmission[frame]


@njit(**INNER)
def _render_frame(iq, transmission, layer, rays, pieces, seen, places, weakened):  # type: ignore[no-untyped-def]
    """Add the surfaces' pieces that one frame sees; the layer is empty before and after."""
    for number in range(len(seen)):
        _add_piece(layer, rays, pieces, seen[number], places[number], 1, 1.0, 0)
    margin = np.int64(_OWN_SHADOW * rays.samples_per_metre)
    cast_shadows(transmission, layer, margin)
    for number in range(len(seen)):
        i = seen[number]
        level = pieces.reverberation[pieces.surfaces[i]]
        kind = pieces.pulses[pieces.surfaces[i]]
        if kind > 0:
            _add_piece(layer, rays, pieces, i, places[number], 1, 1.0, kind)
            continue
        times = 2
        again = level
        while again > _FAINTEST:
            _add_piece(layer, rays, pieces, i, places[number], times, again, kind)
            again *= level
            times += 1
    join_layer(iq, transmission, layer, weakened)
