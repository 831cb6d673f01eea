"""Echoes of needles, point by point and piece by piece, with their shadows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import add_point, seen_within
from sonoservo.systems.ultrasound.simulation.kernels.layers import add_layer, empty_layer
from sonoservo.systems.ultrasound.simulation.kernels.projection import transformed
from sonoservo.systems.ultrasound.simulation.needles.needle_tip import NeedleTip

Floats = NDArray[np.float64]


class NeedleEcho(NamedTuple):
    """Amplitudes of a needle's points."""

    spacing: float
    """Distance between points along the shaft, in m."""
    specular: float
    """Amplitude of each point, all in phase."""
    diffuse: float
    """Amplitude of each point, with phases fixed by the needle's surface."""
    tip: int
    """Number of points from the tip whose part in phase is that of the tip's pieces."""
    taper: Floats
    """(tip,) factors on the diffuse amplitude of these points, from less and less surface."""
    piece: complex
    """Amplitude of the tip's surface per area, where it faces the probe."""
    shadow: float
    """Share of the amplitude that is lost behind a needle in the middle of the beam."""
    radius: float
    """Radius of the needle, in m."""
    surface: NeedleTip
    """Pieces of the tip's surface."""
    phases: NDArray[np.complex128]
    """(n,) phase factors of the diffuse points, tip first; used periodically."""
    pulse: NDArray[np.float32]
    """(FRACTIONS + 1, 2 taps) pulse with the reverberations inside the needle."""


class NeedleView(NamedTuple):
    """What a needle's echo depends on in every frame; factors are given at nodes from the tip."""

    specular: Floats
    """(frames, nodes) factors on the specular amplitude."""
    diffuse: Floats
    """(frames, nodes) factors on the diffuse amplitude."""
    cosine: Floats
    """(frames, nodes) cosines of the angle between the beam and the needle's normal."""
    axes: Floats
    """(frames, 3, 3) axes of the needle's frame at the tip in F, as rows."""
    towards: Floats
    """(frames, 3) directions from the tip to the probe in F, times the factor of its fading."""
    points_per_node: float
    dimple: float
    """Amplitude of a dimple."""
    dimple_step: int
    """Number of points from one dimple to the next."""
    dimpled: int
    """Number of points behind the tip in the dimpled part."""


def together(
    shafts: Sequence[Floats],
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the points of all frames' shafts, and (frames + 1,) indices of each frame's first."""
    return np.concatenate(shafts), np.cumsum([0, *(len(shaft) for shaft in shafts)])


@njit(**OPTIONS)
def incidence(shafts, starts, X_FT, centre_offset, node, count):  # type: ignore[no-untyped-def]
    """Return the angles at which sound meets needles, at nodes ``node`` m apart from the tip on.

    The results are (frames, count) sines of the angle between the beam and the needle's normal, and
    (frames, 3) unit directions in F from the tip to the probe. Shafts are as in `render_needles`,
    and continue straight beyond their entry. See `needle_view` for the offset.
    """
    sines, towards = np.zeros((len(X_FT), count)), np.zeros((len(X_FT), 3))
    for frame in range(len(X_FT)):
        shaft = shafts[starts[frame] : starts[frame + 1]]
        k = len(shaft) - 1
        if k < 1:
            continue
        passed = 0.0
        length = _step(shaft, k)
        x, y, _ = transformed(X_FT[frame], shaft[k, 0], shaft[k, 1], shaft[k, 2])
        for i in range(count):
            along = (i + 1) * node - passed
            while k > 1 and along > length:
                along -= length
                passed += length
                k -= 1
                length = _step(shaft, k)
            share = along / length
            xn, yn, _ = transformed(
                X_FT[frame],
                shaft[k, 0] + share * (shaft[k - 1, 0] - shaft[k, 0]),
                shaft[k, 1] + share * (shaft[k - 1, 1] - shaft[k, 1]),
                shaft[k, 2] + share * (shaft[k - 1, 2] - shaft[k, 2]),
            )
            away = y + centre_offset
            r = np.sqrt(x * x + away * away)
            if i == 0:
                towards[frame, 0] = -x / r
                towards[frame, 1] = -away / r
            sines[frame, i] = min(abs((x - xn) * x + (y - yn) * away) / (r * node), 1.0)
            x, y = xn, yn
    return sines, towards


@njit(**INNER)
def _step(shaft, k):  # type: ignore[no-untyped-def]
    """Return the distance of point k of a shaft from the one before."""
    dx = shaft[k, 0] - shaft[k - 1, 0]
    dy = shaft[k, 1] - shaft[k - 1, 1]
    dz = shaft[k, 2] - shaft[k - 1, 2]
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@njit(**OPTIONS)
def render_needles(iq, X_FT, rays, shafts, starts, echo, view, transmission):  # type: ignore[no-untyped-def]
    """Add the needle to every frame, with its shadow.

    Shafts are (m, 3) points in T on the axis, entry first, of all frames together, with (frames +
    1,) indices of each frame's first; ``transmission`` is empty if nothing lies in the sound's way.
    """
    frames, lines, samples = iq.shape
    layer = empty_layer(lines, samples, echo.pulse.shape[1] // 2)
    for frame in range(frames):
        shaft = shafts[starts[frame] : starts[frame + 1]]
        if len(shaft) > 1:
            seen = _add_tip(layer, X_FT[frame], rays, shaft[-1], echo, view, frame)
            seen |= _add_needle(layer, X_FT[frame], rays, shaft, echo, view, frame)
            if seen:
                _cast_shadow(iq[frame], layer)
                if len(transmission) > 0:
                    _weaken_layer(layer, transmission[frame])
                add_layer(iq[frame], layer)


@njit(**INNER)
def _add_needle(layer, X_FT, rays, shaft, echo, view, frame):  # type: ignore[no-untyped-def]
    """Add a needle's echo, point by point from the tip; return True if the frame sees any.

    The front wall, which reflects the sound, is closer than the axis by the radius times the cosine
    of the angle.
    """
    slab = seen_within(rays)
    last = view.specular.shape[1] - 2
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
            along += echo.spacing
            number += 1
            x, y, z = transformed(
                X_FT,
                shaft[segment, 0] + share * dx,
                shaft[segment, 1] + share * dy,
                shaft[segment, 2] + share * dz,
            )
            if abs(z) > slab:
                continue
            i = number - 1
            at = i / view.points_per_node
            node = min(np.int64(at), last)
            at = min(at - node, 1.0)
            specular = echo.specular if i >= echo.tip else 0.0
            specular *= view.specular[frame, node] * (1 - at) + view.specular[frame, node + 1] * at
            diffuse = echo.diffuse * (echo.taper[i] if i < echo.tip else 1.0)
            diffuse *= view.diffuse[frame, node] * (1 - at) + view.diffuse[frame, node + 1] * at
            closer = view.cosine[frame, node] * (1 - at) + view.cosine[frame, node + 1] * at
            if echo.tip <= i < view.dimpled and i % view.dimple_step == 0:
                diffuse += view.dimple
            amplitude = specular + diffuse * echo.phases[i % len(echo.phases)]
            seen |= add_point(
                layer, rays, echo.pulse, (x, y, z), closer * echo.radius, amplitude, echo.shadow
            )
        along -= length
    return seen


@njit(**INNER)
def _add_tip(layer, X_FT, rays, p_TTip, echo, view, frame):  # type: ignore[no-untyped-def]
    """Add the echo of a tip's surface at (3,) p_TTip; return True if the frame sees any piece."""
    tip = echo.surface
    x, y, z = transformed(X_FT, p_TTip[0], p_TTip[1], p_TTip[2])
    if abs(z) > seen_within(rays) + 2 * echo.tip * echo.spacing:
        return False
    axes = view.axes[frame]
    p, q, r = view.towards[frame]
    t0 = axes[0, 0] * p + axes[0, 1] * q + axes[0, 2] * r
    t1 = axes[1, 0] * p + axes[1, 1] * q + axes[1, 2] * r
    t2 = axes[2, 0] * p + axes[2, 1] * q + axes[2, 2] * r
    seen = False
    for i in range(len(tip.areas)):
        normal = tip.normals[i]
        facing = normal[0] * t0 + normal[1] * t1 + normal[2] * t2
        if facing <= 0.0:
            continue
        a, b, c = tip.points[i]
        place = (
            x + a * axes[0, 0] + b * axes[1, 0] + c * axes[2, 0],
            y + a * axes[0, 1] + b * axes[1, 1] + c * axes[2, 1],
            z + a * axes[0, 2] + b * axes[1, 2] + c * axes[2, 2],
        )
        amplitude = echo.piece * tip.areas[i] * facing
        seen |= add_point(layer, rays, echo.pulse, place, 0.0, amplitude, 0.0)
    return seen


@njit(**INNER)
def _cast_shadow(iq, layer):  # type: ignore[no-untyped-def]
    """Weaken the (lines, samples) echoes that lie in a layer's shadow."""
    lines, samples = iq.shape
    pad = (layer.echoes.shape[1] // 2 - samples) // 2
    for j in range(lines):
        loss = np.float32(0)
        for i in range(max(layer.spans[j, 0] - pad, 0), samples):
            iq[j, i] *= np.float32(1) - loss
            loss = max(loss, layer.loss[j, i])


@njit(**INNER)
def _weaken_layer(layer, transmission):  # type: ignore[no-untyped-def]
    """Weaken a layer by a frame's (lines, samples) transmission."""
    lines, samples = transmission.shape
    pad = (layer.echoes.shape[1] // 2 - samples) // 2
    for j in range(lines):
        for i in range(max(layer.spans[j, 0] - pad, 0), min(layer.spans[j, 1] - pad, samples)):
            layer.echoes[j, 2 * (i + pad)] *= transmission[j, i]
            layer.echoes[j, 2 * (i + pad) + 1] *= transmission[j, i]
