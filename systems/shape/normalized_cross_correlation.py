"""Normalized cross-correlation, which finds a smaller array in a larger one."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfftn, next_fast_len, rfftn
from scipy.ndimage import maximum_filter

from sonoservo.systems.signals.immutable import Immutable, NotFound, Shape, read_only
from sonoservo.systems.signals.requirements import require

_MIN_ENERGY = {np.dtype(np.float32): 1e-6, np.dtype(np.float64): 1e-12}
"""Smallest energy of a window that counts as not constant, as a share of the search region's.

Rounding errors can be as large as this.
"""


@dataclass(frozen=True, eq=False)
class Match(Immutable):
    """Place at which a kernel was found, the (n,) fractional index of its first element."""

    position: Annotated[NDArray[np.float64], Shape(None)]
    correlation: float
    at_border: NDArray[np.bool_]
    """(n,) flags of the axes along which the best match is the first or the last one that fits, so
    that a better one may lie beyond."""


def normalized_cross_correlation(search: ArrayLike, kernel: ArrayLike) -> NDArray[np.floating]:
    """Return the correlation coefficient of a kernel with every window of a search region.

    The equation is eq. 8 of Zhao 2012 with the mean of each window, computed as by Lewis 1995; a
    constant window or kernel gives 0. In single precision the error reaches 1e-3 where a window
    varies 1000 times less than the region. Raises ValueError if shapes or values are not usable.
    """
    # A circular Fourier transform gives the numerator; no window of the result wraps around it.
    # Running sums give the means and energies of the windows.
    whole, part = np.asarray(search), np.asarray(kernel)
    dtype = np.float32 if whole.dtype == part.dtype == np.float32 else np.float64
    whole = read_only(whole, "search", (None,) * whole.ndim, dtype)
    part = read_only(part, "kernel", (None,) * whole.ndim, dtype)
    fits = all(0 < m <= M for m, M in zip(part.shape, whole.shape, strict=True))
    require(fits, "kernel.shape", part.shape, f"from 1 to {whole.shape} along each axis")
    rounding = np.finfo(dtype).eps ** 2 * max(np.vdot(whole, whole), np.vdot(part, part))
    whole = whole - whole.mean()
    part = part - part.mean()
    axes = tuple(range(whole.ndim))
    lengths = [next_fast_len(M, real=True) for M in whole.shape]
    spectrum = rfftn(whole, lengths, axes) * rfftn(part, lengths, axes).conj()
    valid = tuple(slice(M - m + 1) for m, M in zip(part.shape, whole.shape, strict=True))
    numerator = irfftn(spectrum, lengths, axes)[valid]
    total, energy = _window_sums(np.stack([whole, whole * whole], dtype=np.float64), part.shape)
    energy -= total * total / part.size
    part_energy = float(np.vdot(part, part))
    least = _MIN_ENERGY[np.dtype(dtype)] * float(np.vdot(whole, whole)) + rounding
    rho = np.zeros(numerator.shape, dtype)
    if part_energy > rounding:
        norm = np.sqrt(part_energy * np.abs(energy))
        np.divide(numerator, norm, out=rho, where=energy > least)
    return np.clip(rho, -1, 1, out=rho)


def _window_sums(arrays: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the sums over every window of a shape, for each of the stacked arrays (Crow 1984)."""
    for axis, m in enumerate(shape, start=1):
        sums = np.cumsum(arrays, axis=axis)
        ahead = np.take(sums, range(m - 1, sums.shape[axis]), axis)
        behind = [slice(None)] * sums.ndim
        behind[axis] = slice(1, None)
        ahead[tuple(behind)] -= np.take(sums, range(sums.shape[axis] - m), axis)
        arrays = ahead
    return arrays


def best_match(
    search: ArrayLike,
    kernel: ArrayLike,
    log_prior: NDArray[np.float64] | None = None,
    least: float = 0.0,
) -> Match | NotFound:
    """Find the place in a search region at which a kernel correlates best, to subelement accuracy.

    ``log_prior`` is the logarithm of each place's prior density over the number of cells of speckle
    in the kernel, each of which contributes -ln(1 - rho^2) / 2. With it, the most probable of the
    peaks with at least the correlation ``least`` is taken.
    """
    whole, part = np.asarray(search), np.asarray(kernel)
    if whole.ndim != part.ndim or np.any(np.array(part.shape) > whole.shape):
        return NotFound("the kernel does not fit into the search region")
    if not (np.isfinite(whole).all() and np.isfinite(part).all()):
        return NotFound("an intensity is not finite")
    if part.size == 0 or np.ptp(part) == 0:
        return NotFound("the kernel is constant")
    rho = normalized_cross_correlation(whole, part)
    score = rho
    if log_prior is not None:
        told = -0.5 * np.log1p(-(np.minimum(rho, 1 - 1e-6) ** 2), dtype=np.float64)
        # A prior chooses between peaks; it must not pull the place down the flank of one.
        peaks = (rho == maximum_filter(rho, 3)) & (rho >= min(least, rho.max()))
        score = np.where(peaks, told + log_prior, -np.inf)
    peak = np.unravel_index(np.argmax(score), rho.shape)
    if not rho[peak] > 0:
        return NotFound("nothing in the search region resembles the kernel")
    index = np.array(peak)
    last = np.array(rho.shape) - 1
    at_border = (index == 0) | (index == last)
    inner = np.flatnonzero(~at_border)
    around = rho[
        tuple(i if out else slice(i - 1, i + 2) for i, out in zip(peak, at_border, strict=True))
    ]
    position = index.astype(float)
    position[inner] += _peak_offset(around.astype(float))
    return Match(position, float(rho[peak]), at_border & (last > 0))


def _peak_offset(around: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n,) offset of a maximum from the middle of its (3, 3, ...) neighbourhood.

    The paraboloid through the neighbours has its curvature along each axis from the cosine through
    three values (Cespedes et al. 1995): exact for a carrier, and the parabola's for a wide peak.
    """
    n = around.ndim

    def value(*steps: tuple[int, int]) -> float:
        at = np.ones(n, int)
        for axis, step in steps:
            at[axis] += step
        return float(around[tuple(at)])

    offset = np.array([_cosine_peak(value((i, -1)), value(), value((i, 1))) for i in range(n)])
    slope, curvature = np.zeros(n), np.zeros((n, n))
    for i in range(n):
        slope[i] = (value((i, 1)) - value((i, -1))) / 2
        curvature[i, i] = value((i, 1)) - 2 * value() + value((i, -1))
        if abs(offset[i]) > 1e-6:
            curvature[i, i] = -slope[i] / offset[i]
        for j in range(i):
            corners = [a * b * value((i, a), (j, b)) for a in (-1, 1) for b in (-1, 1)]
            curvature[i, j] = curvature[j, i] = sum(corners) / 4
    if n and np.linalg.eigvalsh(curvature)[-1] < 0:
        offset = -np.linalg.solve(curvature, slope)
    return np.clip(offset, -1, 1)


def _cosine_peak(before: float, peak: float, after: float) -> float:
    """Return the position, from -0.5 to 0.5, of the maximum of the cosine through 3 values.

    0 if there is no such cosine, as for a peak of 0.
    """
    if not abs(before + after) < 2 * peak:
        return 0.0
    step = np.arccos((before + after) / (2 * peak))
    return float(np.clip(np.arctan2(after - before, 2 * peak * np.sin(step)) / step, -0.5, 0.5))
