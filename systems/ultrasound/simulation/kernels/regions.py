"""Parts of the tissue with other scattering: labels of an anatomy, lumens of vessels, and fat."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import INNER

_GOLDEN = 0.6180339887498949


class Regions(NamedTuple):
    """Regions of the tissue with other scattering."""

    first_block: NDArray[np.int64]
    """(3,) number of the first block; see `ScattererTile`."""
    content: NDArray[np.int32]
    """(bx, by, bz) numbers of the blocks' lists of segments; -1 for plain tissue."""
    starts: NDArray[np.int32]
    """(lists + 1,) start of each list in ``members``."""
    members: NDArray[np.int32]
    """Segments of tubes that may pass through a block."""
    ends: NDArray[np.float64]
    """(segments, 2, 3) ends of the tubes' segments in T, in m."""
    tubes: NDArray[np.int32]
    """(segments,) number of the tube that each segment belongs to."""
    tube_amplitudes: NDArray[np.float32]
    """(tubes,) factors on the amplitude of scatterers within each tube."""
    labels: NDArray[np.uint8]
    """(nx, ny, nz) labels of cubes."""
    origin: NDArray[np.float64]
    """(3,) corner of the first cube in T, in m."""
    per_metre: float
    """Number of cubes per metre."""
    amplitudes: NDArray[np.float32]
    """(labels,) factors on the amplitude of scatterers."""
    shares: NDArray[np.float32]
    """(labels,) shares of the scatterers that are kept; the amplitude compensates for the rest."""
    fat_thickness: float
    """Thickness of the fat from the tissue's top, in m."""
    fat_amplitude: float
    """Factor on the amplitude of scatterers in the fat."""
    quantiles: NDArray[np.float64]
    """(256,) shuffled quantiles of the standard normal distribution, used as rates of blood."""


NO_REGIONS = Regions(
    first_block=np.zeros(3, np.int64),
    content=np.empty((0, 0, 0), np.int32),
    starts=np.zeros(1, np.int32),
    members=np.empty(0, np.int32),
    ends=np.empty((0, 2, 3)),
    tubes=np.empty(0, np.int32),
    tube_amplitudes=np.empty(0, np.float32),
    labels=np.empty((0, 0, 0), np.uint8),
    origin=np.zeros(3),
    per_metre=1.0,
    amplitudes=np.empty(0, np.float32),
    shares=np.empty(0, np.float32),
    fat_thickness=0.0,
    fat_amplitude=1.0,
    quantiles=np.empty(0),
)
"""Regions of plain tissue."""


@njit(**INNER)
def weigh_scatterers(  # type: ignore[no-untyped-def]
    chosen, count, xs, ys, zs, x0, y0, z0, block_list, cosine, sine, regions, lumens
):
    """Weigh a block's chosen scatterers by the regions they lie in; return the number left.

    Positions are in T, within the block and of its corner; ``block_list`` is the block's entry in
    ``regions.content``. ``lumens`` are (2, tubes) radii in m and standard deviations in rad of the
    phases by which flowing blood has turned. Amplitudes, cosine and sine, are changed.
    """
    nx, ny, nz = regions.labels.shape
    left = 0
    for number in range(count):
        i = chosen[number]
        x = x0 + xs[i]
        y = y0 + ys[i]
        z = z0 + zs[i]
        label = 0
        a = (x - regions.origin[0]) * regions.per_metre
        b = (y - regions.origin[1]) * regions.per_metre
        c = (z - regions.origin[2]) * regions.per_metre
        if 0 <= a < nx and 0 <= b < ny and 0 <= c < nz:
            label = regions.labels[np.int64(a), np.int64(b), np.int64(c)]
        # Positions are random, so any rule that ignores them thins the scatterers at random.
        mark = np.float64(i) * _GOLDEN
        if mark - np.int64(mark) >= regions.shares[label]:
            continue
        factor = regions.amplitudes[label]
        if z > -regions.fat_thickness:
            factor *= np.float32(regions.fat_amplitude)
        turn = 0.0
        for k in range(regions.starts[block_list], regions.starts[block_list + 1]):
            segment = regions.members[k]
            tube = regions.tubes[segment]
            if _within(x, y, z, regions.ends[segment], lumens[0, tube]):
                factor = regions.tube_amplitudes[tube]
                turn = lumens[1, tube]
        cosine[i] *= factor
        sine[i] *= factor
        if turn != 0:
            # Phases that turn at normally distributed rates decorrelate like a Gaussian beam's echo
            # of scatterers that pass through it.
            phase = turn * regions.quantiles[i % len(regions.quantiles)]
            along = np.float32(np.cos(phase))
            across = np.float32(np.sin(phase))
            real = cosine[i]
            cosine[i] = real * along - sine[i] * across
            sine[i] = real * across + sine[i] * along
        chosen[left] = i
        left += 1
    return left


@njit(**INNER)
def _within(x, y, z, ends, radius):  # type: ignore[no-untyped-def]
    """Return True if a point lies within a radius of a straight segment, (2, 3)."""
    ax = ends[1, 0] - ends[0, 0]
    ay = ends[1, 1] - ends[0, 1]
    az = ends[1, 2] - ends[0, 2]
    px = x - ends[0, 0]
    py = y - ends[0, 1]
    pz = z - ends[0, 2]
    share = (px * ax + py * ay + pz * az) / (ax * ax + ay * ay + az * az)
    share = min(max(share, 0.0), 1.0)
    px -= share * ax
    py -= share * ay
    pz -= share * az
    return px * px + py * py + pz * pz < radius * radius
