"""Projection of a point onto a frame: its line, elevation offset and phase.

The coordinate frame F of a frame of the sweep has its origin on the motor's axis, X along the
array, Y along the middle line of the frame and Z in elevation. The other lines are turned by
``twist`` per line of distance from the middle, because the motor never stops.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER

FRACTIONS = 64
"""Number of fractions of a sample for which pulses are tabulated."""

_HALF = np.float32(0.5)
_ONE = np.float32(1)
_TWO = np.float32(2)
_PI = np.float32(np.pi)
_POSITIVE = np.float32(1024)
# Minimax polynomials, to 1e-6: sine and cosine on [-pi/2, pi/2], arc tangent on [-0.65, 0.65].
_S3, _S5, _S7 = (np.float32(c) for c in (-0.16665681, 0.00831237, -0.00018492))
_C4, _C6, _C8 = (np.float32(c) for c in (0.041665440, -0.00138652311, 2.33793852e-05))
_A3, _A5, _A7, _A9 = (np.float32(c) for c in (-0.33320355, 0.19732617, -0.12394153, 0.05127381))
_EIGHTH = np.float32(0.125)
# Minimax polynomial of exp(-v) on [0, 0.6], to 1e-6.
_E1, _E2, _E3, _E4 = (np.float32(c) for c in (-0.99994248, 0.49904756, -0.16171851, 0.03126755))


class Rays(NamedTuple):
    """Geometry and phase of a frame's lines, in float32, and what depends on a sample's depth."""

    array_radius: np.float32
    centre_offset: np.float32
    lines_per_radian: np.float32
    middle_line: np.float32
    twist: np.float32
    samples_per_metre: np.float32
    turns_per_metre: np.float32
    lead: int
    """Number of samples from the beginning of a pulse to the one before its middle."""
    elevation_lobes: np.float32
    """Amplitude of a bright point's side lobes in elevation, relative to its main lobe."""
    side_lobes: np.float32
    """Amplitude of its other side lobes."""
    elevation_precision: NDArray[np.float32]
    """(samples,) precision of the beam in elevation, 1 / (2 sigma_e^2), in 1/m^2."""
    curvature: NDArray[np.float32]
    """(samples,) curvature of the wave fronts in elevation, in 1/m."""
    share: NDArray[np.float32]
    """(samples,) share of the tile's scatterers that is used."""
    line_sigma: NDArray[np.float32]
    """(samples,) standard deviation of the beam, in lines."""
    bright: NDArray[np.float32]
    """(samples,) factor on bright points, since tissue is normalised to 0 dB at any depth."""


@njit(**INNER)
def line_coordinates(x, y, z, rays):  # type: ignore[no-untyped-def]
    """Return the fractional line, elevation offset and distance from the array's centre.

    The point is in F, in m. The lines' turns are small angles, so second order suffices: the error
    is 0.1 um over a frame of the sweep.
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


@njit(**INNER)
def phasor(turns):  # type: ignore[no-untyped-def]
    """Return the cosine and sine of an angle in turns (above -1024)."""
    h = turns - (np.float32(np.int32(turns + _HALF + _POSITIVE)) - _POSITIVE)
    h *= _PI
    v = h * h
    s = h * (_ONE + v * (_S3 + v * (_S5 + v * _S7)))
    c = _ONE - v * (_HALF - v * (_C4 + v * (_C6 + v * _C8)))
    return _ONE - _TWO * s * s, _TWO * s * c


@njit(**INNER)
def bright_echo(rays, place, times, closer, furthest):  # type: ignore[no-untyped-def]
    """Return where and with which phase a bright point in F shows after a number of round trips.

    The results are the first sample of its echo (-1 if the frame does not see it), the pulse's
    fraction, the line, the distance from the array's centre in m, the sample at its depth, half the
    square of its standard deviations in elevation, at most ``furthest``, and cosine and sine of the
    phase. The reflecting surface is closer than the point by ``closer`` m.
    """
    line, e, r = line_coordinates(place[0], place[1], place[2], rays)
    depth = r - rays.array_radius
    at = np.int64(depth * rays.samples_per_metre + 0.5)
    if at < 0 or at >= rays.bright.size:
        return -1, 0, line, r, 0, 0.0, _ONE, _ONE
    u = rays.elevation_precision[at] * e * e
    path = times * (depth + 0.5 * rays.curvature[at] * e * e) - closer
    sample = path * rays.samples_per_metre
    k = np.int64(sample)
    if u > furthest or sample < 0 or k >= rays.bright.size:
        return -1, 0, line, r, at, u, _ONE, _ONE
    c, s = phasor(np.float32(path * rays.turns_per_metre))
    return k, np.int64((sample - k) * FRACTIONS + 0.5), line, r, at, u, c, s


@njit(**INNER)
def transformed(X, x, y, z):  # type: ignore[no-untyped-def]
    """Return the coordinates of a point after a (3, 4) transform."""
    return (
        X[0, 0] * x + X[0, 1] * y + X[0, 2] * z + X[0, 3],
        X[1, 0] * x + X[1, 1] * y + X[1, 2] * z + X[1, 3],
        X[2, 0] * x + X[2, 1] * y + X[2, 2] * z + X[2, 3],
    )


@njit(**INNER)
def gaussian(u):  # type: ignore[no-untyped-def]
    """Return exp(-u) for u from 0 to 4.8."""
    v = u * _EIGHTH
    w = _ONE + v * (_E1 + v * (_E2 + v * (_E3 + v * _E4)))
    w *= w
    w *= w
    return w * w
