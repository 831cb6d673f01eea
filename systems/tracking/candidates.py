"""Candidate voxels near a predicted needle."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import scattered
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis import Axis


@njit(cache=True, nogil=True, error_model="numpy")
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
    """Find the voxels near an axis, each with a key by which to sort them.

    A key's first 16 bits are the number of the voxel's slab, the next 16 its darkness in 1/256 of a
    grey level, and the last 32 order equal ones by hash.
    """
    capacity = 4096
    index = np.empty((capacity, 3), np.int32)
    key = np.empty(capacity, np.uint64)
    _, ny, nz = intensities.shape
    found = 0
    order = coefficients.shape[0]
    for i in range(lower[0], upper[0]):
        x = origin[0] + spacing[0] * i
        for j in range(lower[1], upper[1]):
            y = origin[1] + spacing[1] * j
            base = (x - axis_origin[0]) * direction[0] + (y - axis_origin[1]) * direction[1]
            for k in range(lower[2], upper[2]):
                if intensities[i, j, k] == 0:  # nothing echoes, whether it was seen or not
                    continue
                z = origin[2] + spacing[2] * k
                a = base + (z - axis_origin[2]) * direction[2]
                if a < start or a >= stop:
                    continue
                dx, dy, dz, power = x, y, z, 1.0
                for n in range(order):
                    dx -= coefficients[n, 0] * power
                    dy -= coefficients[n, 1] * power
                    dz -= coefficients[n, 2] * power
                    power *= a
                if dx * dx + dy * dy + dz * dz > radius * radius:
                    continue
                if found == capacity:
                    capacity *= 2
                    index = np.concatenate((index, np.empty_like(index)))
                    key = np.concatenate((key, np.empty_like(key)))
                index[found, 0], index[found, 1], index[found, 2] = i, j, k
                level = min(max(256 * float(intensities[i, j, k]), 0.0), 65535.0)
                number = np.uint64(min((a - start) / slab, 65535.0)) << np.uint64(16)
                key[found] = (number + np.uint64(65535 - int(level))) << np.uint64(32)
                key[found] += scattered((i * ny + j) * nz + k)
                found += 1
    return index[:found], key[:found]


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

    The region follows the axis from ``start`` to ``stop`` (m). Each slab across it has a threshold
    of its own, by which ``cross_section`` (m^2) is filled: the needle is some 20 dB brighter where
    the sound meets it at a right angle, and a common threshold would select voxels there only.
    """
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
    index, number = index[order], (key[order] >> np.uint64(48)).astype(np.int64)
    value = volume.intensities[index[:, 0], index[:, 1], index[:, 2]].astype(float)
    first = np.searchsorted(number, np.arange(math.ceil((stop - start) / slab) + 1))
    rank = np.arange(len(value)) - first[number]
    count = max(1, round(cross_section * slab / float(np.prod(volume.spacing))))
    chosen = rank < count
    last = np.minimum(first[number] + count, first[number + 1]) - 1
    span = value[first[number]] - value[last]
    weights = (value - value[last] + 0.1 * span + 1e-9) / (1.1 * span + 1e-9)
    return Candidates(volume.position(index[chosen]), weights[chosen])
