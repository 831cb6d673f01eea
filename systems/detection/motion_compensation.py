"""Compensation of the probe's motion between two volumes."""

from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.interpolation import flagged, trilinear
from sonoservo.systems.signals.volume import Volume

_STRIDE = 5
"""Every so manieth voxel along each axis shows whether the tissue moved along with the probe."""


@njit(cache=True, nogil=True, error_model="numpy")
def _resample(  # pragma: no cover - compiled
    intensities: Any, seen: Any, R: Any, offset: Any
) -> Any:
    """Return the intensities at the indices R i + offset of each element i, and what was seen."""
    nx, ny, nz = intensities.shape
    result, shown = np.zeros_like(intensities), np.zeros(intensities.shape, np.bool_)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                x = R[0, 0] * i + R[0, 1] * j + R[0, 2] * k + offset[0]
                y = R[1, 0] * i + R[1, 1] * j + R[1, 2] * k + offset[1]
                z = R[2, 0] * i + R[2, 1] * j + R[2, 2] * k + offset[2]
                if 0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1:
                    result[i, j, k] = trilinear(intensities, x, y, z)
                    shown[i, j, k] = flagged(seen, x, y, z)
    return result, shown


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64], seen: NDArray[np.bool_]) -> float:
    """Return the correlation of two sets of intensities where both were seen."""
    if np.count_nonzero(seen) < 2 or a[seen].std() == 0 or b[seen].std() == 0:
        return 0.0
    return float(np.corrcoef(a[seen], b[seen])[0, 1])


def compensate_motion(volume: Volume, previous: Volume, min_correlation: float) -> Volume | None:
    """Return the previous volume as the probe would have seen it from where it is now.

    If the probe moved across resting tissue, the previous volume is resampled according to the
    measured poses. If the tissue moved along with the probe, as it does when a patient breathes, it
    is returned unchanged. A sample of the voxels shows which of the two it was.

    Parameters
    ----------
    volume, previous
        Volumes on the same grid.
    min_correlation
        Smallest correlation of the two volumes; None is returned if neither case reaches it.
    """
    X_PvPn = previous.X_WP.InvertAndCompose(volume.X_WP)
    axes = (np.arange(0, count, _STRIDE) for count in volume.intensities.shape)
    index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    at = tuple(index.T)
    now, before = (each.intensities[at].astype(float) for each in (volume, previous))
    places = X_PvPn.multiply(volume.position(index).T).T
    moved = previous.sample(places).astype(float)
    seen = volume.seen[at]
    together = _correlation(now, before, seen & previous.seen[at])
    across = _correlation(now, moved, seen & previous.sees(places))
    if max(together, across) < min_correlation:
        return None
    if together >= across:
        return previous
    R = X_PvPn.rotation().matrix() * volume.spacing / volume.spacing[:, np.newaxis]
    offset = previous.index(X_PvPn.multiply(volume.origin))
    intensities, mask = _resample(previous.intensities, previous.seen, R, offset)
    return replace(previous, intensities=intensities, mask=mask)
