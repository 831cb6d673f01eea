"""Position of a thin needle's echo in a slice."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound

Floats = NDArray[np.float64]


def echo_vertex(
    image: ImageSlice, near: Floats, fitted: Sequence[float], reach: Sequence[float]
) -> Floats | NotFound:
    """Return the (2,) vertex in P, in m, of the brightest echo within ``reach`` of ``near``.

    The echo of a thin needle is the beam's point spread function, which is nearly a Gaussian. Its
    logarithm is a paraboloid, fitted by least squares to the pixels within ``fitted`` of the
    brightest. Both are half widths and half heights in m.
    """
    half = np.maximum(np.rint(fitted / image.spacing).astype(int), 1)
    pixels = np.maximum(np.rint(reach / image.spacing).astype(int), 1)
    first = np.rint(image.index(near)).astype(int) - pixels - half
    last = first + 2 * (pixels + half) + 1
    if np.any(first < 0) or np.any(last > image.intensities.shape):
        return NotFound("the needle is at the edge of the image")
    around = image.intensities[first[0] : last[0], first[1] : last[1]].astype(np.float64)
    windows = np.lib.stride_tricks.sliding_window_view(around, tuple(2 * half + 1))
    # Across the beam the echo is as wide as the window. Along the beam it is as thin as a pixel.
    level = windows[..., half[1]].mean(axis=2)
    window = np.array(np.unravel_index(np.argmax(level), level.shape))
    offset = _paraboloid_vertex(windows[tuple(window)])
    return image.position(first + window + half + np.clip(offset, -half, half))


def _paraboloid_vertex(values: Floats) -> Floats:
    """Return the (2,) offset of the vertex from the middle of an odd-sized array, in elements."""
    _, a, b, c, d, e = _paraboloid_fit(values.shape) @ values.ravel()
    determinant = 4 * c * e - d * d
    if c >= 0 or determinant <= 0:
        return np.zeros(2)
    return np.array([d * b - 2 * e * a, d * a - 2 * c * b]) / determinant


@lru_cache
def _paraboloid_fit(shape: tuple[int, int]) -> Floats:
    """Return the (6, n) matrix that fits the coefficients of 1, i, j, i^2, ij, j^2."""
    rows, columns = ((extent - 1) // 2 for extent in shape)
    i, j = np.meshgrid(
        np.arange(-rows, rows + 1.0), np.arange(-columns, columns + 1.0), indexing="ij"
    )
    design = np.stack([np.ones_like(i), i, j, i * i, i * j, j * j], axis=-1).reshape(-1, 6)
    return np.linalg.pinv(design)
