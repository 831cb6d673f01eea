"""Blur of a single point, and of a needle's end, in a volume."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA
from sonoservo.systems.signals.sweep import blur_covariance, line_axes
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.speckle_width import speckle_spread

_BLUR_POINTS = 9
"""Number of points of an axis at which the blur's width is computed; it varies little between."""

_measured_spread = lru_cache(maxsize=1)(speckle_spread)
"""Widths measured from a volume's speckle; all axes tried in a volume ask for them."""

_FINEST = 1e-3
"""Standard deviation in m of a line's course at best, by which an echo counts as blurred, too."""


def needle_blur(
    volume: Volume,
    p_P: NDArray[np.float64],
    along: NDArray[np.float64],
    beam_width: float | None,
) -> NDArray[np.float64] | None:
    """Return the (m,) full widths at half maximum in m of a needle's blurred end, along its axis.

    None if the volume does not tell. They are measured from the speckle if the volume does not know
    its point spread and no ``beam_width`` is given.
    """
    # On the axis, the end is blurred with 1 / sqrt(k^T Sigma^-1 k), where Sigma is the covariance
    # of the point spread and k the needle's direction; projected on the axis, with
    # sqrt(k^T Sigma k). The profile's tube has a radius in between, so the mean of both is taken.
    few = np.linspace(0, len(p_P) - 1, _BLUR_POINTS).astype(int)
    covariance = echo_covariance(volume, p_P[few], measure=beam_width is None)
    if covariance is None:
        return None
    projected = np.sqrt(covariance @ along @ along)
    width = FWHM_PER_SIGMA * 0.5 * (projected + _on_axis(covariance, along))
    return np.interp(np.arange(len(p_P)), few, width)


def streak_lengths(volume: Volume, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n,) largest full widths in m of points' echoes along lines with ends in P.

    They are 0 if the volume does not tell them.
    """
    n = len(ends)
    covariance = echo_covariance(volume, np.linspace(ends[:, 0], ends[:, 1], 3).reshape(-1, 3))
    if covariance is None:
        return np.zeros(n)
    along = ends[:, 1] - ends[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    inverse = np.linalg.inv(covariance.reshape(3, n, 3, 3) + _FINEST**2 * np.eye(3))
    return np.asarray(
        FWHM_PER_SIGMA / np.sqrt(np.einsum("pnij,ni,nj->pn", inverse, along, along).min(axis=0))
    )


def echo_covariance(
    volume: Volume, p_P: NDArray[np.float64], measure: bool = True
) -> NDArray[np.float64] | None:
    """Return the (m, 3, 3) covariances in m^2 of the echoes of points at (m, 3) p_P, or None.

    They are those of the volume's transducer or, with ``measure``, of its speckle.
    """
    if volume.point_spread is not None and volume.motion is not None:
        return blur_covariance(volume.point_spread, volume.motion.geometry, p_P)
    if measure and (measured := _measured_spread(volume)) is not None:
        lateral, elevation, axial = measured.widths(p_P[:, 1]).T / FWHM_PER_SIGMA
        widths = np.stack([lateral, axial, elevation], axis=-1)
        return np.asarray(widths[:, np.newaxis] ** 2 * np.eye(3))
    return None


def sound_directions(volume: Volume, p_P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (m, 3) directions of sound at (m, 3) positions in P; along Y, if unknown."""
    if volume.motion is None:
        return np.broadcast_to([0.0, 1.0, 0.0], p_P.shape)
    return line_axes(volume.motion.geometry, p_P)[0][:, 2]


def _on_axis(covariance: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(1 / np.sqrt(np.linalg.inv(covariance) @ along @ along))
