"""Formation of grey levels (coupling, noise, log compression) and radio-frequency lines."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER, OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.blocks import way_through

_LOG2_10 = np.log2(10)
_SOFT_EDGE = 0.5e-3
# Minimax polynomial of log2(1 + m) on [0, 1], to 2e-6.
_L1, _L2, _L3, _L4, _L5, _L6 = (
    np.float32(c)
    for c in (1.44255314, -0.71828191, 0.45827078, -0.27953809, 0.12345144, -0.02645743)
)


class Console(NamedTuple):
    """Settings by which echoes become grey levels."""

    box: NDArray[np.float64]
    """Bounds of the tissue in T, in m; see `BodySurface.bounds`."""
    gel_thickness: float
    noise: NDArray[np.float32]
    """(samples,) root mean square of the electronic noise."""
    grey_per_db: float
    offsets: NDArray[np.float32]
    """(samples,) grey levels at 0 dB."""
    clutter: NDArray[np.float32]
    """(2 samples,) amplitudes of the haze that stays, every value twice."""
    lasting: float
    """Factor on the tissue's echoes, of which a part changes."""


class Acquired(NamedTuple):
    """Poses of n frames, and what is added to their echoes."""

    X_TP: NDArray[np.float64]
    """(n, 3, 4) poses of the probe in the tissue."""
    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    """(n, lines, 3) rays of the lines in P; see `coupling`."""
    open_shares: NDArray[np.float32]
    """(n, lines) factors on lines under which air lies."""
    keys: NDArray[np.unsignedinteger]
    """(n,) numbers that select the noise."""
    field: NDArray[np.complex64]
    """(n, lines, samples) speckle of the probe, or empty."""
    changing: NDArray[np.complex128]
    """(n,) amplitudes of the part that changes; real and imaginary part weigh two fields."""


@njit(**OPTIONS)
def form_image(grey, iq, console, frames):  # type: ignore[no-untyped-def]
    """Convert every frame's echoes to (frames, lines, samples) uint8 grey levels."""
    for frame in range(len(grey)):
        share = coupling(
            frames.X_TP[frame], frames.origins[frame], frames.directions[frame], console.box,
            console.gel_thickness,
        )  # fmt: skip
        share *= frames.open_shares[frame]
        if frames.field.size > 0:
            changing = frames.changing[frame]
            add_haze(iq[frame], frames.field[frame], console.clutter, changing, console.lasting)
        compress(
            grey[frame], iq[frame], share, console.noise, frames.keys[frame], console.grey_per_db,
            console.offsets,
        )  # fmt: skip


@njit(**INNER)
def add_haze(iq, field, clutter, changing, lasting):  # type: ignore[no-untyped-def]
    """Add clutter and a slowly changing part to the (lines, samples) echoes of a frame."""
    lines = len(iq)
    first, second = np.float32(changing.real), np.float32(changing.imag)
    keep = np.float32(lasting)
    # As rows of real numbers, which the compiler vectorises.
    echoes = iq.view(np.float32)
    speckle = field.view(np.float32)
    for j in range(lines):
        own = speckle[j]
        one = speckle[(j + lines // 3) % lines]
        other = speckle[(j + 2 * lines // 3) % lines]
        for i in range(echoes.shape[1]):
            part = first * one[i] + second * other[i]
            echoes[j, i] = keep * echoes[j, i] + clutter[i] * own[i] + part


@njit(**OPTIONS)
def coupling(X_TP, origins, directions, box, gel_thickness):  # type: ignore[no-untyped-def]
    """Return (lines,) float32 shares of the sound that reach the tissue along a frame's lines.

    Lines leave the face at (lines, 3) origins along unit directions, in P, with the (3, 4) pose
    X_TP; the gel fills paths up to its thickness in m, beyond which the sound fades over 0.5 mm.
    """
    share = np.empty(len(origins), np.float32)
    point = np.empty(3)
    along = np.empty(3)
    for j in range(len(origins)):
        for axis in range(3):
            start = X_TP[axis, 3]
            slope = 0.0
            for other in range(3):
                start += X_TP[axis, other] * origins[j, other]
                slope += X_TP[axis, other] * directions[j, other]
            point[axis] = start
            along[axis] = slope
        enter, leave = way_through(point, along, box)
        excess = (enter - gel_thickness) / _SOFT_EDGE
        share[j] = 0.0 if leave < enter else 1.0 - min(max(excess, 0.0), 1.0)
    return share


@njit(**OPTIONS)
def compress(grey, iq, share, noise, key, grey_per_db, offsets):  # type: ignore[no-untyped-def]
    """Write a frame's echoes with noise as grey levels, rounded to nearest.

    Echoes are weighed by the (lines,) coupling; ``noise`` is the (samples,) root mean square of
    what the uint64 key selects; a grey level is grey_per_db x level in dB + the sample's offset.
    """
    lines, samples = iq.shape
    power = np.empty(samples, np.float32)
    bits = power.view(np.int32)
    # Sum of four uniform bytes, with unit variance for real and imaginary part together.
    scale = np.float32(np.sqrt(0.5 / ((256.0**2 - 1) / 3)))
    slope = np.float32(grey_per_db * 10 / _LOG2_10)
    half = np.float32(0.5)
    byte = np.uint64(255)
    for j in range(lines):
        counter = key + np.uint64(j * samples) * np.uint64(0x9E3779B97F4A7C15)
        for i in range(samples):
            # SplitMix64 (Steele et al. 2014) of the sample's number, so the noise needs no state.
            counter += np.uint64(0x9E3779B97F4A7C15)
            z = counter
            z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            z = z ^ (z >> np.uint64(31))
            a = np.int32(z & byte)
            a += np.int32((z >> np.uint64(8)) & byte)
            a += np.int32((z >> np.uint64(16)) & byte)
            a += np.int32((z >> np.uint64(24)) & byte) - np.int32(510)
            b = np.int32((z >> np.uint64(32)) & byte)
            b += np.int32((z >> np.uint64(40)) & byte)
            b += np.int32((z >> np.uint64(48)) & byte)
            b += np.int32(z >> np.uint64(56)) - np.int32(510)
            level = noise[i] * scale
            real = share[j] * iq[j, i].real + level * np.float32(a)
            imaginary = share[j] * iq[j, i].imag + level * np.float32(b)
            power[i] = real * real + imaginary * imaginary + np.float32(1e-12)
        for i in range(samples):
            # log2 from the floating-point format: exponent, and a polynomial in the mantissa.
            exponent = np.float32((bits[i] >> np.int32(23)) - np.int32(127))
            bits[i] = (bits[i] & np.int32(0x007FFFFF)) | np.int32(0x3F800000)
            m = power[i] - np.float32(1)
            log2 = exponent + m * (_L1 + m * (_L2 + m * (_L3 + m * (_L4 + m * (_L5 + m * _L6)))))
            level = slope * log2 + offsets[i] + half
            grey[j, i] = np.uint8(min(max(level, np.float32(0)), np.float32(255.5)))


@njit(**OPTIONS)
def modulate(lines, iq, cosine, sine):  # type: ignore[no-untyped-def]
    """Write (frames, lines, samples) echoes times a (samples,) carrier's cosine and sine."""
    for frame in range(len(lines)):
        for j in range(lines.shape[1]):
            for i in range(lines.shape[2]):
                echo = iq[frame, j, i]
                lines[frame, j, i] = echo.real * cosine[i] - echo.imag * sine[i]
