"""Echoes of a frame: scatterers and bright points become samples along the scan lines.

COLE, the convolution of line echoes (Gao et al. 2009), in two stages. Every scatterer is projected
on its nearest scan lines and deposited there with its exact two-way phase and the pulse's envelope;
then neighbouring lines are blurred to the beam's width, which depends on depth.

Frame F of a frame of the sweep: origin on the motor's axis, X along the array, Y along the middle
line of the frame, Z in elevation. All other lines of the frame are turned by ``twist`` for each
line's distance from the middle, because the motor never stops.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

FLOAT = NDArray[np.float32]
OPTIONS = {"cache": True, "fastmath": True, "error_model": "numpy", "nogil": True}

FRACTIONS = 64
"""Fractions of a sample for which the pulse is tabulated."""

SPLINE_VARIANCE = 0.25
"""Variance of the quadratic B-spline that spreads an echo over three lines, in lines^2."""

FADE = 0.1
"""Half width, relative to the share of scatterers used at a depth, over which more fade in."""

REACH = 3.0
"""Standard deviations beyond which the main lobe is left out."""

_HALF = np.float32(0.5)
_ONE = np.float32(1)
_TWO = np.float32(2)
_THREE_QUARTERS = np.float32(0.75)
_EIGHTH = np.float32(0.125)
_PI = np.float32(np.pi)
_POSITIVE = np.float32(1024)
_ZERO = np.float32(0)
_FURTHEST = np.float32(REACH**2 / 2)
_FADE_OUT = np.float32(1 + FADE)
_FADE_WIDTH = np.float32(2 * FADE)
# Minimax polynomials, to 1e-6: sine and cosine on [-pi/2, pi/2], arc tangent on [-0.65, 0.65] and
# exp(-v) on [0, 0.6].
_S3, _S5, _S7 = (np.float32(c) for c in (-0.16665681, 0.00831237, -0.00018492))
_C4, _C6, _C8 = (np.float32(c) for c in (0.041665440, -0.00138652311, 2.33793852e-05))
_A3, _A5, _A7, _A9 = (np.float32(c) for c in (-0.33320355, 0.19732617, -0.12394153, 0.05127381))
_E1, _E2, _E3, _E4 = (np.float32(c) for c in (-0.99994248, 0.49904756, -0.16171851, 0.03126755))


class Rays(NamedTuple):
    """Where the lines of a frame are, in float32."""

    array_radius: np.float32
    centre_offset: np.float32
    lines_per_radian: np.float32
    middle_line: np.float32
    twist: np.float32
    samples_per_metre: np.float32
    turns_per_metre: np.float32
    lead: int
    """Samples from the beginning of a pulse to the one before its middle."""


class DepthTables(NamedTuple):
    """What depends on depth, at every sample."""

    elevation_precision: FLOAT
    """1 / (2 sigma_e^2)."""
    curvature: FLOAT
    share: FLOAT
    """Of the tile's scatterers."""
    line_sigma: FLOAT
    """sigma_l, in lines."""
    bright: FLOAT
    """Factor on bright points, which keeps them right relative to the tissue, always 0 dB."""


@njit(**OPTIONS)
def line_coordinates(x, y, z, rays):  # type: ignore[no-untyped-def]
    """Fractional line, elevation offset and distance from the array's centre of a point in F.

    The lines' turns are small angles, so second order suffices: 0.1 um over a sweep's frame.
    """
    q = y + rays.centre_offset
    r = np.sqrt(q * q + x * x)
    u = x / (q + r)
    v = u * u
    phi = _TWO * u * (_ONE + v * (_A3 + v * (_A5 + v * (_A7 + v * _A9))))
    line = phi * rays.lines_per_radian
    turn = rays.twist * line
    shift = z * turn - _HALF * y * turn * turn
    line -= x * shift / (r * r) * rays.lines_per_radian
    return line + rays.middle_line, z - y * turn, r + q * shift / r


@njit(**OPTIONS)
def phasor(turns):  # type: ignore[no-untyped-def]
    """Cosine and sine of an angle in turns (above -1024)."""
    h = turns - (np.float32(np.int32(turns + _HALF + _POSITIVE)) - _POSITIVE)
    h *= _PI
    v = h * h
    s = h * (_ONE + v * (_S3 + v * (_S5 + v * _S7)))
    c = _ONE - v * (_HALF - v * (_C4 + v * (_C6 + v * _C8)))
    return _ONE - _TWO * s * s, _TWO * s * c


@njit(**OPTIONS)
def _gaussian(u):  # type: ignore[no-untyped-def]
    """exp(-u) for u from 0 to 4.8."""
    v = u * _EIGHTH
    w = _ONE + v * (_E1 + v * (_E2 + v * (_E3 + v * _E4)))
    w *= w
    w *= w
    return w * w


@njit(**OPTIONS)
def deposit_tissue(  # type: ignore[no-untyped-def]
    real, imaginary, X_FT, box, block_size, positions, ranks, starts, blocks, rays, tables, pulse
):
    """Deposit the scatterers that a frame's beam meets.

    Parameters
    ----------
    real, imaginary
        (lines + 2 pad, samples + 2 taps) accumulators.
    X_FT
        (3, 4) pose of the tissue in F, float64.
    box
        (2, 3) lower and upper corner of the tissue in T.
    block_size, positions, ranks, starts, blocks
        The scatterer tile, ``blocks`` along its edge.
    rays, tables
        Of the frame.
    pulse
        (FRACTIONS + 1, taps) envelope around a scatterer.
    """
    lines, samples = real.shape
    taps = pulse.shape[1]
    pad = (lines - 1) / 2 - rays.middle_line
    count = samples - 2 * taps
    R = X_FT[:, :3].astype(np.float32)
    depth = (count - 1) / rays.samples_per_metre
    # The frame's bounding box in T, and the part of the tissue in it.
    half_angle = (rays.middle_line + pad) / rays.lines_per_radian
    far = depth + rays.array_radius
    half_width = far * np.sin(min(half_angle, np.pi / 2))
    thickest = REACH / np.sqrt(2 * tables.elevation_precision.min())
    thickest += abs(rays.twist) * rays.middle_line * far
    near_y = rays.array_radius * np.cos(min(half_angle, np.pi / 2)) - rays.centre_offset
    middle = np.array([0.0, (near_y + far - rays.centre_offset) / 2, 0.0])
    half = np.array([half_width, (far - rays.centre_offset - near_y) / 2, thickest])
    lower = np.empty(3, np.int64)
    upper = np.empty(3, np.int64)
    for axis in range(3):
        centre = 0.0
        extent = 0.0
        for other in range(3):
            centre += X_FT[other, axis] * (middle[other] - X_FT[other, 3])
            extent += abs(X_FT[other, axis]) * half[other]
        lower[axis] = np.int64(np.floor(max(centre - extent, box[0, axis]) / block_size))
        upper[axis] = np.int64(np.ceil(min(centre + extent, box[1, axis]) / block_size))
    radius = 0.87 * block_size
    support = 0.0
    for axis in range(3):
        support += abs(X_FT[2, axis]) * block_size / 2
    largest = 0
    for block in range(starts.size - 1):
        largest = max(largest, starts[block + 1] - starts[block])
    at_line = np.empty(largest, np.float32)
    at_sample = np.empty(largest, np.float32)
    cosine = np.empty(largest, np.float32)
    sine = np.empty(largest, np.float32)
    for bx in range(lower[0], upper[0]):
        for by in range(lower[1], upper[1]):
            for bz in range(lower[2], upper[2]):
                cx = (bx + 0.5) * block_size
                cy = (by + 0.5) * block_size
                cz = (bz + 0.5) * block_size
                x = X_FT[0, 0] * cx + X_FT[0, 1] * cy + X_FT[0, 2] * cz + X_FT[0, 3]
                y = X_FT[1, 0] * cx + X_FT[1, 1] * cy + X_FT[1, 2] * cz + X_FT[1, 3]
                z = X_FT[2, 0] * cx + X_FT[2, 1] * cy + X_FT[2, 2] * cz + X_FT[2, 3]
                q = y + rays.centre_offset
                r = np.sqrt(q * q + x * x)
                d = r - rays.array_radius
                if d < -radius or d > depth + radius or q < -radius:
                    continue
                phi = np.arctan2(x, q)
                margin = radius / max(r, radius)
                if abs(phi) > half_angle + margin:
                    continue
                at = min(max(np.int64(d * rays.samples_per_metre), 1), count - 2)
                slab = 1.05 * REACH / np.sqrt(2 * tables.elevation_precision[at])
                slab += support + abs(rays.twist) * rays.lines_per_radian * margin * y
                if abs(z - y * rays.twist * phi * rays.lines_per_radian) > slab:
                    continue
                # Within the block, what depends on depth does so linearly.
                span = min(np.int64(radius * rays.samples_per_metre) + 1, at, count - 1 - at)
                metres = np.float32(2 * span / rays.samples_per_metre)
                depth0 = np.float32(at / rays.samples_per_metre) + rays.array_radius
                k0 = tables.elevation_precision[at]
                k1 = (
                    tables.elevation_precision[at + span] - tables.elevation_precision[at - span]
                ) / metres
                c0 = tables.curvature[at]
                p0 = tables.share[at]
                p1 = (tables.share[at + span] - tables.share[at - span]) / metres
                block = ((bx % blocks) * blocks + by % blocks) * blocks + bz % blocks
                start = starts[block]
                most = max(tables.share[at + span], tables.share[at - span], p0) * (1 + FADE)
                n = np.searchsorted(ranks[start : starts[block + 1]], np.float32(most))
                ox = np.float32(x - (X_FT[0, 0] + X_FT[0, 1] + X_FT[0, 2]) * block_size / 2)
                oy = np.float32(y - (X_FT[1, 0] + X_FT[1, 1] + X_FT[1, 2]) * block_size / 2)
                oz = np.float32(z - (X_FT[2, 0] + X_FT[2, 1] + X_FT[2, 2]) * block_size / 2)
                for i in range(n):
                    tx = positions[0, start + i]
                    ty = positions[1, start + i]
                    tz = positions[2, start + i]
                    line, e, r32 = line_coordinates(
                        R[0, 0] * tx + R[0, 1] * ty + R[0, 2] * tz + ox,
                        R[1, 0] * tx + R[1, 1] * ty + R[1, 2] * tz + oy,
                        R[2, 0] * tx + R[2, 1] * ty + R[2, 2] * tz + oz,
                        rays,
                    )
                    ahead = r32 - depth0
                    p = p0 + p1 * ahead
                    u = (k0 + k1 * ahead) * e * e
                    weight = (p * _FADE_OUT - ranks[start + i]) / (p * _FADE_WIDTH)
                    weight = min(max(weight, _ZERO), _ONE)
                    weight = weight * _gaussian(min(u, _FURTHEST)) if u < _FURTHEST else _ZERO
                    path = r32 - rays.array_radius + _HALF * c0 * e * e
                    c, s = phasor(path * rays.turns_per_metre)
                    at_line[i] = line
                    at_sample[i] = path * rays.samples_per_metre
                    cosine[i] = weight * c
                    sine[i] = -weight * s
                edge = (
                    bx * block_size < box[0, 0]
                    or by * block_size < box[0, 1]
                    or bz * block_size < box[0, 2]
                    or (bx + 1) * block_size > box[1, 0]
                    or (by + 1) * block_size > box[1, 1]
                    or (bz + 1) * block_size > box[1, 2]
                )
                for i in range(n):
                    re = cosine[i]
                    im = sine[i]
                    if re == _ZERO and im == _ZERO:
                        continue
                    if edge:
                        tx = bx * block_size + positions[0, start + i]
                        ty = by * block_size + positions[1, start + i]
                        tz = bz * block_size + positions[2, start + i]
                        if (
                            tx < box[0, 0]
                            or tx > box[1, 0]
                            or ty < box[0, 1]
                            or ty > box[1, 1]
                            or tz < box[0, 2]
                            or tz > box[1, 2]
                        ):
                            continue
                    line = at_line[i] + np.float32(pad)
                    j = np.int32(line + _HALF)
                    if line < _HALF or j > lines - 2:
                        continue
                    sample = at_sample[i] + np.float32(taps - rays.lead)
                    k = np.int32(sample)
                    if sample < _ZERO or k > samples - taps:
                        continue
                    fraction = np.int32((sample - np.float32(k)) * np.float32(FRACTIONS) + _HALF)
                    t = line - np.float32(j)
                    below = _HALF * (_HALF - t) * (_HALF - t)
                    above = _HALF * (_HALF + t) * (_HALF + t)
                    at_peak = _THREE_QUARTERS - t * t
                    for tap in range(taps):
                        w = pulse[fraction, tap]
                        a = w * re
                        b = w * im
                        real[j - 1, k + tap] += below * a
                        imaginary[j - 1, k + tap] += below * b
                        real[j, k + tap] += at_peak * a
                        imaginary[j, k + tap] += at_peak * b
                        real[j + 1, k + tap] += above * a
                        imaginary[j + 1, k + tap] += above * b
