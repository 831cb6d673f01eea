"""Trilinear interpolation of a sweep's samples at the elements of a Cartesian grid."""

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.sampling.kernels import OPTIONS

WIDEST_ANGLE = 2 * np.arctan(0.8)
"""Largest angle in rad, 77 deg, from the middle of the sector that `_angle` covers."""

_ZERO, _HALF, _ONE, _TWO = (np.float32(value) for value in (0, 0.5, 1, 2))
# Minimax polynomial of the arc tangent on [-0.8, 0.8], to 3e-7.
_A3, _A5, _A7, _A9, _A11 = (
    np.float32(c) for c in (-0.33325730, 0.19850147, -0.13226215, 0.074819914, -0.023065584)
)
_BYTE = np.uint32(0xFF)
_POSITIVE = np.uint32(0x7FFFFFFF)
"""Mask that tells the compiler that an index is not negative."""

_PAGE, _CACHE_LINE = 1024, 16
"""Sizes of a memory page and a cache line, in elements of four bytes."""


Floats = NDArray[np.floating]


class Sector(NamedTuple):
    """Positions of a sweep's lines (see `SweepGeometry`) in float32; lengths in m."""

    array_radius: np.float32
    centre_offset: np.float32
    samples_per_metre: np.float32
    lines_per_radian: np.float32
    steps_per_radian: np.float32
    """Motor steps per radian about the motor's axis; the motor takes one step per line."""
    direction: np.float32
    lines: np.float32
    last_frame: np.float32
    last_line: np.float32
    last_sample: np.float32


class Corners(NamedTuple):
    """Layout of packed samples: each number holds a sample and its neighbours in the frame.

    A processor can then read the eight corners of a cell with two instructions, for several cells
    at a time.
    """

    frame_stride: np.int32
    line_stride: np.int32
    first_frame: np.int32
    first_line: np.int32
    first_sample: np.int32
    last_frame: np.int32
    """Frame of the last cell; the next two are its line and its sample."""
    last_line: np.int32
    last_sample: np.int32


def pack_corners(
    samples: NDArray[np.uint8], first: tuple[int, ...], last: tuple[int, ...]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], Corners]:
    """Pack samples, each with its neighbours, from the first cell to the last.

    Return the packed samples, a view of them from the second frame on, and their layout. The bytes
    of a number are, lowest first: the sample, the next one on its line, the sample on the next
    line, and the one after that.
    """
    frames, lines, line_stride = (b - a + 1 for a, b in zip(first, last, strict=True))
    # A frame's stride must not be a multiple of the page: neighbours would evict one another from
    # the cache.
    frame_stride = lines * line_stride
    frame_stride += (_CACHE_LINE - frame_stride) % _PAGE
    packed = np.empty((frames + 1) * frame_stride, np.uint32)
    corners = Corners(
        np.int32(frame_stride),
        np.int32(line_stride),
        *(np.int32(n) for n in (*first, *last)),
    )
    _pack(packed, corners, samples)
    return packed, packed[frame_stride:], corners


@njit(parallel=True, **OPTIONS)
def _pack(packed, corners, samples):  # type: ignore[no-untyped-def]
    for frame in prange(corners.last_frame - corners.first_frame + 2):
        for line in range(corners.last_line - corners.first_line + 1):
            here = samples[corners.first_frame + frame, corners.first_line + line]
            beside = samples[corners.first_frame + frame, corners.first_line + line + 1]
            at = frame * corners.frame_stride + line * corners.line_stride
            for n in range(corners.line_stride):
                i = corners.first_sample + n
                packed[at + n] = (
                    np.uint32(here[i])
                    | np.uint32(here[i + 1]) << np.uint32(8)
                    | np.uint32(beside[i]) << np.uint32(16)
                    | np.uint32(beside[i + 1]) << np.uint32(24)
                )


def rows_in_sector(
    sector: Sector, margin: ArrayLike, x: Floats, y: Floats, z: Floats
) -> NDArray[np.int32]:
    """Return the (nx, ny, 2, 2) ranges of each row along Z that may lie in the sector.

    A row has two parts, on either side of a gap that the lines do not reach or the probe occupies;
    an empty part ends where it starts. Elements may be displaced by up to the margin, (3,) or one
    number in m, before they are looked up. The origin is on the motor's axis.
    """
    beside, above, along = np.broadcast_to(np.asarray(margin, dtype=float), (3,))
    x, y = np.abs(x[:, np.newaxis]), y[np.newaxis]
    nearest_x, nearest_y = np.maximum(x - beside, 0), np.maximum(np.abs(y) - above, 0)
    far = sector.array_radius + sector.last_sample / sector.samples_per_metre
    outermost_line = 0.5 * sector.last_line / sector.lines_per_radian
    outermost_frame = 0.5 * sector.lines * sector.last_frame / sector.steps_per_radian
    # All conditions are on q = rho + centre_offset and on the angle, which both grow with |z|.
    min_q = np.maximum(
        np.sqrt(np.maximum(float(sector.array_radius) ** 2 - (x + beside) ** 2, 0)),
        nearest_x / np.tan(outermost_line),
    )
    least = np.maximum(min_q - sector.centre_offset, 0)
    most = np.sqrt(np.maximum(far**2 - nearest_x**2, 0)) - sector.centre_offset
    low = np.sqrt(np.maximum(least**2 - (np.abs(y) + above) ** 2, 0)) - along
    high = along + np.minimum(
        np.sqrt(np.maximum(most**2 - nearest_y**2, 0)), (y + above) * np.tan(outermost_frame)
    )
    empty = (most <= nearest_y) | (high < low) | (y + above <= 0)
    gap = (low > 0) & ~empty
    lower = np.stack([-high, low], axis=-1)
    upper = np.stack([np.where(gap, -low, high), high], axis=-1)
    pitch = z[1] - z[0]
    start = np.clip(np.ceil((lower - z[0]) / pitch), 0, len(z))
    stop = np.clip(np.floor((upper - z[0]) / pitch) + 1, start, len(z))
    used = np.stack([~empty, gap], axis=-1)
    return np.stack([start, np.where(used, stop, start)], axis=-1).astype(np.int32)


# The compiler vectorises the innermost loops because their indices are unsigned, nothing in them
# branches, and the arrays are the kernel's own arguments: it knows that the arguments of a parallel
# kernel do not overlap.


@njit(parallel=True, **OPTIONS)
def resample(volume, rows, packed, beyond, corners, sector, x, distance, step):  # type: ignore[no-untyped-def]
    """Fill the part of a (nx, ny, nz) uint8 volume of zeros that lies in the sector.

    Rows are those of `rows_in_sector`, packed samples those of `pack_corners`; x are (nx,) float32
    coordinates in m, and distance and step (ny, nz) float32 distances q from the array's centre of
    curvature within the plane of the line in m, and steps of the motor from the middle.
    """
    for a in prange(volume.shape[0]):
        for b in range(volume.shape[1]):
            for part in range(2):
                for n in range(np.uint64(rows[a, b, part, 0]), np.uint64(rows[a, b, part, 1])):
                    line, r = line_of(x[a], distance[b, n], sector)
                    volume[a, b, n] = interpolate(
                        packed, beyond, corners, sector, step[b, n], line, r
                    )


@njit(**OPTIONS)
def _angle(opposite, adjacent, hypotenuse):  # type: ignore[no-untyped-def]
    """Return the angle in rad between a hypotenuse and its adjacent leg, up to `WIDEST_ANGLE`."""
    t = opposite / (adjacent + hypotenuse)
    v = t * t
    return _TWO * t * (_ONE + v * (_A3 + v * (_A5 + v * (_A7 + v * (_A9 + v * _A11)))))


@njit(**OPTIONS)
def line_of(x, q, sector):  # type: ignore[no-untyped-def]
    """Return the line, from the middle, and the distance from the array's centre of curvature."""
    r = np.sqrt(q * q + x * x)
    return _angle(x, q, r) * sector.lines_per_radian, r


@njit(**OPTIONS)
def project(x, y, z, sector):  # type: ignore[no-untyped-def]
    """Return step and line, from the middle, and distance from the array's centre of curvature."""
    rho = np.sqrt(y * y + z * z)
    line, r = line_of(x, rho + sector.centre_offset, sector)
    # A point behind the axis, possible with a moving probe, is outside the sector either way.
    return _angle(z, max(y, _ZERO), rho) * sector.steps_per_radian, line, r


@njit(**OPTIONS)
def frame_of(step, line, sector):  # type: ignore[no-untyped-def]
    """Return the frame in which the motor, at a step from the middle, takes a line."""
    return (step - sector.direction * line) / sector.lines + _HALF * sector.last_frame


@njit(**OPTIONS)
def sweeps(sector, step, line, r):  # type: ignore[no-untyped-def]
    """Return True if both motor directions sweep a place."""
    i = (r - sector.array_radius) * sector.samples_per_metre
    return (
        (i >= _ZERO)
        & (i <= sector.last_sample)
        & (abs(line) <= _HALF * sector.last_line)
        & (abs(step) + abs(line) <= _HALF * sector.lines * sector.last_frame)
    )


@njit(**OPTIONS)
def interpolate(packed, beyond, corners, sector, step, line, r):  # type: ignore[no-untyped-def]
    """Return the rounded grey level at a place; zero unless both motor directions sweep it."""
    i = (r - sector.array_radius) * sector.samples_per_metre
    j = line + _HALF * sector.last_line
    k = frame_of(step, line, sector)
    inside = sweeps(sector, step, line, r)
    i0 = min(max(np.int32(i), corners.first_sample), corners.last_sample)
    j0 = min(max(np.int32(j), corners.first_line), corners.last_line)
    k0 = min(max(np.int32(k), corners.first_frame), corners.last_frame)
    at = np.uint32(
        (k0 - corners.first_frame) * corners.frame_stride
        + (j0 - corners.first_line) * corners.line_stride
        + (i0 - corners.first_sample)
    )
    along, across = i - np.float32(i0), j - np.float32(j0)
    here = _bilinear(packed[at & _POSITIVE], along, across)
    there = _bilinear(beyond[at & _POSITIVE], along, across)
    grey = here + (k - np.float32(k0)) * (there - here)
    return np.uint8(np.int32(grey + _HALF)) if inside else np.uint8(0)


@njit(**OPTIONS)
def _bilinear(packed, along, across):  # type: ignore[no-untyped-def]
    a = np.float32(np.int32(packed & _BYTE))
    b = np.float32(np.int32(packed >> np.uint32(8) & _BYTE))
    c = np.float32(np.int32(packed >> np.uint32(16) & _BYTE))
    d = np.float32(np.int32(packed >> np.uint32(24)))
    here = a + along * (b - a)
    return here + across * (c + along * (d - c) - here)
