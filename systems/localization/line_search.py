"""Search of a whole volume for long thin bright lines, one of which may be a lost needle."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from sonoservo.systems.signals.volume import Volume


@njit(cache=True, nogil=True)
def _block_maxima(intensities: Any, bx: int, by: int, bz: int) -> Any:  # pragma: no cover
    """Return the largest value in each block of voxels, and the index of its voxel."""
    nx, ny, nz = intensities.shape
    shape = ((nx + bx - 1) // bx, (ny + by - 1) // by, (nz + bz - 1) // bz)
    maxima = np.zeros(shape, np.float32)
    where = np.zeros((*shape, 3), np.int16)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                value = intensities[i, j, k]
                if value > maxima[i // bx, j // by, k // bz]:
                    maxima[i // bx, j // by, k // bz] = value
                    where[i // bx, j // by, k // bz, 0] = i
                    where[i // bx, j // by, k // bz, 1] = j
                    where[i // bx, j // by, k // bz, 2] = k
    return maxima, where


@njit(cache=True, nogil=True, error_model="numpy")
def _longest_line(  # pragma: no cover - compiled
    points: Any, samples: Any, distance: float, separation: float, pitch: float, gap: int
) -> Any:
    """Return the sample whose line has the longest stretch of points, its score and its ends."""
    bins = 512
    occupied = np.zeros(bins, np.int32)
    best = (-1, 0, 0.0, 0.0)
    for s in range(samples.shape[0]):
        first = points[samples[s, 0]]
        k = points[samples[s, 1]] - first
        length = np.sqrt(np.sum(k * k))
        if length < separation:
            continue
        k = k / length
        low, high = bins, -1
        for m in range(points.shape[0]):
            x = points[m, 0] - first[0]
            y = points[m, 1] - first[1]
            z = points[m, 2] - first[2]
            a = x * k[0] + y * k[1] + z * k[2]
            if x * x + y * y + z * z - a * a < distance * distance:
                at = min(max(int(np.floor(a / pitch)) + bins // 2, 0), bins - 1)
                occupied[at] = s + 1
                low, high = min(low, at), max(high, at)
        start, score, missing = low, 0, 0
        for at in range(low, high + 1):
            if occupied[at] == s + 1:
                if score == 0:
                    start = at
                score += 1
                missing = 0
                if score > best[1]:
                    best = (
                        s, score, (start - bins // 2) * pitch, (at + 1 - bins // 2) * pitch
                    )  # fmt: skip
            else:
                missing += 1
                if missing > gap:
                    score = 0
    return best


def _contrast(maxima: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """Return the contrast of each block with the brightest of its six sides.

    A step, such as the bottom of the tissue, stands out from one side only.

    Parameters
    ----------
    maxima
        Maxima of the blocks; zero outside the field of view.
    reach
        Distance in blocks between a block and the nearest block of a side. A side is a cube whose
        edge is 2 reach + 1 blocks.
    """
    seen = maxima > 0
    width = 2 * reach + 1
    total = uniform_filter(maxima, width, mode="constant")
    share = uniform_filter(seen.astype(np.float32), width, mode="constant")
    mean = np.pad(np.where(share > 0.2, total / np.maximum(share, 0.2), 0), 2 * reach)
    beside = np.zeros_like(maxima)
    inner = tuple(slice(2 * reach, -2 * reach) for _ in range(3))
    for axis in range(3):
        for shift in (-2 * reach, 2 * reach):
            np.maximum(beside, np.roll(mean, shift, axis)[inner], out=beside)
    return np.where(seen, maxima - beside, -np.inf)


def bright_lines(
    volume: Volume,
    rng: np.random.Generator,
    *,
    count: int = 3,
    block: float = 2.2e-3,
    surroundings: float = 16e-3,
    points: int = 500,
    draws: int = 6000,
    distance: float = 2.5e-3,
    separation: float = 6e-3,
    max_gap: float = 5e-3,
) -> list[NDArray[np.float64]]:
    """Find the longest thin bright lines of a volume.

    The volume is reduced to the maxima of blocks. The blocks that stand out most from their
    surroundings are the candidates. A broad bright structure therefore yields few of them. Lines
    through random pairs are scored by the length over which candidates follow one another, not by
    the number of candidates nearby. Compact inclusions therefore score low, however bright they
    are.

    Parameters
    ----------
    volume
        Volume to search.
    rng
        Generator that draws the pairs.
    count
        Largest number of lines.
    block, surroundings
        Edge lengths of the blocks and of the cube with which a block is compared, in m.
    points, draws
        Numbers of candidates and of pairs.
    distance
        Largest distance of a line's candidates from it, in m.
    separation
        Smallest distance between the points of a pair, in m.
    max_gap
        Largest gap between successive candidates along a line, in m.

    Returns
    -------
    Lines, longest first, each (2, 3): ends in the probe frame, in m.
    """
    size = np.maximum(1, np.round(block / volume.spacing)).astype(int)
    maxima, where = _block_maxima(volume.intensities, *size)
    contrast = _contrast(maxima, max(1, round(surroundings / block / 4)))
    top = np.argpartition(contrast.ravel(), -min(points, contrast.size))[-points:]
    top = top[np.isfinite(contrast.ravel()[top]) & (contrast.ravel()[top] > 0)]
    p_P = volume.position(where.reshape(-1, 3)[top])
    lines: list[NDArray[np.float64]] = []
    while len(lines) < count and len(p_P) >= 4:
        samples = rng.integers(0, len(p_P), (draws, 2))
        best, score, start, stop = _longest_line(
            p_P, samples, distance, separation, block, round(max_gap / block)
        )
        if best < 0 or score * block < separation:
            break
        first, second = p_P[samples[best]]
        k = (second - first) / np.linalg.norm(second - first)
        lines.append(first + np.outer([start, stop], k))
        a = (p_P - first) @ k
        near = np.linalg.norm(p_P - first - np.outer(a, k), axis=1) < 2 * distance
        p_P = p_P[~(near & (a > start - block) & (a < stop + block))]
    return lines
