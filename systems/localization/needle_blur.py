"""Blur of a needle's end along its axis."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.localization.speckle_width import speckle_spread
from sonoservo.systems.signals.blur import blur_covariance
from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA
from sonoservo.systems.signals.volume import Volume

_BLUR_POINTS = 9
"""Number of points of an axis at which the blur's width is computed; it varies little between."""

_measured_spread = lru_cache(maxsize=1)(speckle_spread)
"""Widths measured from a volume's speckle; all axes tried in a volume ask for them."""


def needle_blur(
    volume: Volume,
    p_P: NDArray[np.float64],
    along: NDArray[np.float64],
    beam_width: float | None,
) -> NDArray[np.float64] | None:
    """Return the widths of a needle's blurred end at points of its axis.

    On the axis, the end is blurred with a standard deviation of 1 / sqrt(k^T Sigma^-1 k), with
    Sigma the covariance of the point spread and k the needle's direction. Its projection on the
    axis is blurred with sqrt(k^T Sigma k). The tube takes the largest value beside the axis, but
    not far from it, so the mean of both is taken.

    Parameters
    ----------
    volume
        Volume with the needle.
    p_P
        (m, 3) points of the axis in P, in m.
    along
        (3,) direction k in P.
    beam_width
        Width that the user knows, in m; None if the widths are to be measured from the speckle, if
        the volume does not know its point spread.

    Returns
    -------
    (m,) full widths at half maximum in m; None if the volume does not tell them.
    """
    few = np.linspace(0, len(p_P) - 1, _BLUR_POINTS).astype(int)
    if volume.point_spread is not None and volume.motion is not None:
        covariance = blur_covariance(volume.point_spread, volume.motion.geometry, p_P[few])
    elif beam_width is None and (measured := _measured_spread(volume)) is not None:
        lateral, elevation, axial = measured.widths(p_P[few, 1]).T / FWHM_PER_SIGMA
        covariance = np.stack([lateral, axial, elevation], axis=-1)[:, np.newaxis] ** 2 * np.eye(3)
    else:
        return None
    projected = np.sqrt(covariance @ along @ along)
    on_axis = 1 / np.sqrt(np.linalg.inv(covariance) @ along @ along)
    width = FWHM_PER_SIGMA * 0.5 * (projected + on_axis)
    return np.interp(np.arange(len(p_P)), few, width)
