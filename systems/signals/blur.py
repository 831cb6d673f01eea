"""Blur of a swept image at a point, in the probe frame."""

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA, PointSpread
from sonoservo.systems.signals.sweep import SweepGeometry

Floats = NDArray[np.float64]


def blur_covariance(spread: PointSpread, geometry: SweepGeometry, p_P: Floats) -> Floats:
    """Return the (m, 3, 3) covariances in P, in m^2, of Gaussians that approximate points' echoes.

    The spread gives the widths, and the geometry the directions of the lines, at (m, 3) positions
    in P, in m.
    """
    axes, depth = line_axes(geometry, p_P)
    scaled = axes * (spread.widths(depth) / FWHM_PER_SIGMA)[..., np.newaxis]
    return np.asarray(scaled.swapaxes(1, 2) @ scaled)


def line_axes(geometry: SweepGeometry, p_P: Floats) -> tuple[Floats, Floats]:
    """Return (m, 3, 3) unit vectors of the lines through (m, 3) positions in P, and (m,) depths.

    The rows are the directions along the array, across the frame and along the line; depths in m.
    """
    x, y, z = np.asarray(p_P, dtype=float).T
    y = y + geometry.motor_radius
    q = np.hypot(y, z) + geometry.array_radius - geometry.motor_radius
    phi, theta = np.arctan2(x, q), np.arctan2(z, y)
    lateral = [np.cos(phi), -np.sin(phi) * np.cos(theta), -np.sin(phi) * np.sin(theta)]
    elevation = [np.zeros_like(phi), -np.sin(theta), np.cos(theta)]
    axial = [np.sin(phi), np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta)]
    axes = np.array([lateral, elevation, axial]).transpose(2, 0, 1)
    return axes, np.hypot(q, x) - geometry.array_radius
