"""Candidate voxels near a predicted needle."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import OPTIONS, scattered
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis import Axis


@njit(**OPTIONS)
def _voxels_near(  # pragma: no cover - compiled
    intensities: Any,
    origin: Any,
    spacing: Any,
    axis_origin: Any,
    direction: Any,
    coefficients: Any,
    start: float,
    stop: float,
    radius: float,
    slab: float,
    lower: Any,
    upper: Any,
) -> Any:
    """Find the voxels near an axis, by flat index, each with a key by which to sort them.

    A key's first 16 bits are the number of the voxel's slab, the next 16 its darkness in 1/256 of a
    grey level, and the last 32 order equal ones by hash.
    """
    _, ny, nz = intensities.shape
    (ox, oy, oz), (sx, sy, sz) = origin, spacing
    (ax, ay, az), (kx, ky, kz) = axis_origin, direction
    c = np.zeros((4, 3))
    for n in range(len(coefficients)):
        c[n, 0], c[n, 1], c[n, 2] = coefficients[n]
    (bx, by, bz), (cx, cy, cz), (dx, dy, dz), (fx, fy, fz) = c
    # Each voxel is written, and the next one over it unless it counts: no branch stops SIMD.
    size = (upper[0] - lower[0]) * (upper[1] - lower[1]) * (upper[2] - lower[2])
    index, abscissa = np.empty(size + 1, np.int64), np.empty(size + 1)
    found = 0
    for i in range(lower[0], upper[0]):
        x = ox + sx * i
        for j in range(lower[1], upper[1]):
            y = oy + sy * j
            base = (x - ax) * kx + (y - ay) * ky
            for k in range(lower[2], upper[2]):
                z = oz + sz * k
                a = base + (z - az) * kz
                ex = x - bx - cx * a - dx * (a * a) - fx * (a * a * a)
                ey = y - by - cy * a - dy * (a * a) - fy * (a * a * a)
                ez = z - bz - cz * a - dz * (a * a) - fz * (a * a * a)
                near = (a >= start) & (a < stop) & (ex * ex + ey * ey + ez * ez <= radius * radius)
                index[found], abscissa[found] = (i * ny + j) * nz + k, a
                # Where nothing echoes does not count, whether it was seen or not.
                found += int(near & (intensities[i, j, k] != 0))
    index, key, flat = index[:found], np.empty(found, np.uint64), intensities.ravel()
    for n in range(found):
        level = min(max(256 * float(flat[index[n]]), 0.0), 65535.0)
        number = np.uint64(min((abscissa[n] - start) / slab, 65535.0)) << np.uint64(16)
        number = (number + np.uint64(65535 - int(level))) << np.uint64(32)
        key[n] = number + scattered(index[n])
    return index, key


@dataclass(frozen=True, eq=False)
class Candidates:
    """(m, 3) candidates in P in m, with (m,) weights from 0 to 1 by brightness in their slab."""

    p_P: NDArray[np.float64]
    weights: NDArray[np.float64]


def select_candidates(
    volume: Volume,
    axis: Axis,
    *,
    start: float,
    stop: float,
    radius: float,
    cross_section: float,
    slab: float,
) -> Candidates:
    """Select the brightest voxels around a predicted axis in P (Chatelain 2013, eq. 15).

    The region follows the axis from ``start`` to ``stop`` (m).
    """
    # Each slab across it has a threshold of its own, by which ``cross_section`` (m^2) is filled:
    # the needle is some 20 dB brighter where the sound meets it at a right angle, and a common
    # threshold would select voxels there only.
    ends = axis.position(np.linspace(start, stop, 9))
    lower = np.floor((ends.min(axis=0) - radius - volume.origin) / volume.spacing)
    upper = np.ceil((ends.max(axis=0) + radius - volume.origin) / volume.spacing) + 1
    shape = np.array(volume.intensities.shape)
    index, key = _voxels_near(
        volume.intensities,
        volume.origin,
        volume.spacing,
        axis.origin,
        axis.direction,
        axis.coefficients,
        start,
        stop,
        radius,
        slab,
        np.clip(lower, 0, shape).astype(np.int64),
        np.clip(upper, 0, shape).astype(np.int64),
    )
    order = np.argsort(key)  # No two are equal, so every way of sorting gives the same.
    number = (key[order] >> np.uint64(48)).astype(np.int64)
    slabs = np.arange(math.ceil((stop - start) / slab) + 1)
    count = max(1, round(cross_section * slab / float(np.prod(volume.spacing))))
    chosen = np.arange(len(number)) - np.searchsorted(number, slabs)[number] < count
    index, number = index[order[chosen]], number[chosen]
    value = volume.intensities.ravel()[index].astype(float)
    first = np.searchsorted(number, slabs)
    darkest = value[first[number + 1] - 1]
    span = value[first[number]] - darkest
    weights = (value - darkest + 0.1 * span + 1e-9) / (1.1 * span + 1e-9)
    index = np.stack(np.unravel_index(index, volume.intensities.shape), axis=1)
    return Candidates(volume.position(index), weights)
