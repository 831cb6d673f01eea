"""Search for the voxels that changed most between two volumes."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.kernels import chosen_ties

_ALL = np.ones((1, 1, 1), bool)


@njit(cache=True, nogil=True)
def _changes(  # pragma: no cover - compiled
    a: Any, b: Any, seen_a: Any, seen_b: Any, floor: float, reach: int, both: bool,
    brighter_only: bool,
) -> Any:  # fmt: skip
    """Find the voxels brighter than everything nearby in the other volume, and by how much."""
    nx, ny, nz = a.shape
    capacity = 65536
    index = np.empty(capacity, np.int64)
    change = np.empty(capacity, np.float32)
    found = 0
    for i in range(nx):
        for j in range(ny):
            row_a, row_b = a[i, j], b[i, j]
            for k in range(nz):
                x, y = row_a[k], row_b[k]
                if x == y or (x <= floor and y <= floor):
                    continue
                if both and not (seen_a[i, j, k] and seen_b[i, j, k]):
                    continue
                if brighter_only and x < y:
                    continue
                brighter = float(x) if x > y else float(y)
                highest = max(floor, float(y) if x > y else float(x))
                for p in range(max(i - reach, 0), min(i + reach + 1, nx)):
                    for q in range(max(j - reach, 0), min(j + reach + 1, ny)):
                        row = b[p, q] if x > y else a[p, q]
                        for r in range(max(k - reach, 0), min(k + reach + 1, nz)):
                            if row[r] > highest:
                                highest = float(row[r])
                    if highest >= brighter:
                        break
                if highest >= brighter:
                    continue
                if found == capacity:
                    capacity *= 2
                    index = np.concatenate((index, np.empty_like(index)))
                    change = np.concatenate((change, np.empty_like(change)))
                index[found] = (i * ny + j) * nz + k
                change[found] = brighter - highest
                found += 1
    return index[:found], change[:found]


def top_differences(
    current: NDArray[Any],
    previous: NDArray[Any],
    count: int,
    *,
    floor: float = 0.0,
    reach: int = 0,
    seen: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None,
    brighter_only: bool = False,
) -> tuple[NDArray[np.int64], float]:
    """Find the voxels with the largest absolute difference (Chatelain 2013, eq. 1).

    The threshold is the order statistic that leaves ``count`` voxels. Differences of 8-bit values
    have many ties at the threshold. A subset of them is taken that is scattered over the volume.

    With ``floor`` and ``reach`` at zero the difference is that of eq. 1. Speckle, however, has dark
    spots whose level in dB changes wildly as the probe moves by micrometres, and bright inclusions
    have steep edges. Both vanish if levels below ``floor`` count as ``floor``, and if the brighter
    voxel is compared with the brightest one of the other volume within ``reach`` voxels.

    Parameters
    ----------
    current, previous
        (nx, ny, nz) intensities of the same type.
    count
        Wanted number of voxels; fewer are returned only if fewer changed at all.
    floor
        Intensity below which all intensities count as equal.
    reach
        Tolerated displacement in voxels.
    seen
        Flags of the voxels seen in either volume; those that both show are compared. None compares
        all.
    brighter_only
        Whether to leave out voxels that are darker now.

    Returns
    -------
    index, threshold
        (m, 3) indices of the voxels, and the smallest difference among them (0 if nothing changed).
    """
    seen_now, seen_before = seen or (_ALL, _ALL)
    index, change = _changes(
        current, previous, seen_now, seen_before, float(floor), reach, seen is not None,
        brighter_only,
    )  # fmt: skip
    if len(index) == 0:
        return np.empty((0, 3), np.int64), 0.0
    if len(index) > count:
        threshold = np.partition(change, -count)[-count]
        above = index[change > threshold]
        ties = chosen_ties(index[change == threshold], count - len(above))
        index = np.concatenate([above, ties])
    else:
        threshold = change.min()
    return np.stack(np.unravel_index(index, current.shape), axis=1), float(threshold)
