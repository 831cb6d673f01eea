"""Depth-dependent blur across lines, which models the beam's lateral width."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER

_NEGLIGIBLE = 1e-4


class LineKernel(NamedTuple):
    """Weights of the neighbouring lines at every sample."""

    weights: NDArray[np.float32]
    """(2 half + 1, 2 samples) weights, each repeated for the real and the imaginary part."""
    ends: NDArray[np.int64]
    """(2 half + 1,) end of each row's weights, beyond which they are negligible."""


def line_kernel(line_sigma: NDArray[np.float64], lines: int) -> LineKernel:
    """Return the weights that widen the deposits' B-spline to the beam."""
    # At every depth, a sampled Gaussian is chosen. Together with the deposits' spline, it has the
    # beam's energy and the beam's correlation between neighbouring lines, averaged over all
    # positions between lines.
    half = min(int(np.ceil(3 * line_sigma.max())), lines // 4)
    offsets = np.arange(-half, half + 1)
    spline = np.array([1, 26, 66, 26, 1]) / 120  # autocorrelation of the quadratic B-spline
    sigmas = np.linspace(0.1, half, 50 * half)
    correlation = np.empty((len(sigmas), 2))
    for row, sigma in zip(correlation, sigmas, strict=True):
        kernel = np.exp(-(offsets**2) / (2 * sigma**2))
        response = np.convolve(np.convolve(kernel, kernel), spline)
        row[:] = response[len(response) // 2 :][:2]
    wanted = np.exp(-1 / (4 * line_sigma**2))
    sigma = np.interp(wanted, correlation[:, 1] / correlation[:, 0], sigmas)
    energy = np.interp(sigma, sigmas, correlation[:, 0])
    kernel = np.exp(-(offsets[:, np.newaxis] ** 2) / (2 * sigma**2))
    kernel *= np.sqrt(np.sqrt(np.pi) * line_sigma / energy)
    counts = kernel > _NEGLIGIBLE * kernel[half]
    ends = 2 * (counts.shape[1] - counts[:, ::-1].argmax(axis=1)) * counts.any(axis=1)
    return LineKernel(np.repeat(kernel, 2, axis=1).astype(np.float32), ends)


@njit(**INNER)
def blur_lines(iq, accumulator, kernel, taps, row):  # type: ignore[no-untyped-def]
    """Write (lines, samples) deposits blurred across lines; row is memory for (2 samples,).

    See `render_tissue` for the accumulator.
    """
    lines, samples = iq.shape
    pad = (accumulator.shape[0] - lines) // 2
    half = len(kernel.ends) // 2
    for j in range(lines):
        row[:] = np.float32(0)
        for m in range(len(kernel.ends)):
            source = accumulator[j + pad + m - half, 2 * taps :]
            for i in range(kernel.ends[m]):
                row[i] += kernel.weights[m, i] * source[i]
        for i in range(samples):
            iq[j, i] = complex(row[2 * i], row[2 * i + 1])
