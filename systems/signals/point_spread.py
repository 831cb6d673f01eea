"""Resolution of an image: how far the scanner blurs a point, at every depth."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.requirements import require

if TYPE_CHECKING:
    from sonoservo.systems.signals.sweep import SweepGeometry

Floats = NDArray[np.float64]

FWHM_PER_SIGMA = float(2 * np.sqrt(2 * np.log(2)))
"""Full width at half maximum of a Gaussian, over its standard deviation."""


@dataclass(frozen=True, eq=False)
class PointSpread(Immutable):
    """Widths of a point's echo, at half amplitude, by depth.

    Parameters
    ----------
    depth
        (n,) rising distances from the array along a line, in m; between them the widths are
        interpolated, beyond them they stay the same.
    lateral, elevation, axial
        (n,) full widths at half maximum along the array, across the frame and along the line, in m.

    Raises
    ------
    ValueError
        If a length differs, a width is not above zero or the depths do not rise.
    """

    depth: Floats
    lateral: Floats
    elevation: Floats
    axial: Floats

    def __post_init__(self) -> None:
        for name in ("depth", "lateral", "elevation", "axial"):
            count = None if name == "depth" else len(self.depth)
            object.__setattr__(self, name, read_only(getattr(self, name), name, (count,)))
        require(len(self.depth) > 0, "depth", self.depth, "at least one depth")
        require(bool((np.diff(self.depth) > 0).all()), "depth", self.depth, "rising")
        for name in ("lateral", "elevation", "axial"):
            widths = getattr(self, name)
            require(bool((widths > 0).all()), name, widths, "above 0")

    def covariance(self, p_P: Floats, geometry: "SweepGeometry") -> Floats:
        """Covariance of the Gaussian that a point's echo resembles, in P.

        Parameters
        ----------
        p_P
            (m, 3) positions of points in P, in m.
        geometry
            Of the sweep: it tells where the lines run.

        Returns
        -------
        (m, 3, 3) in m^2.
        """
        x, y, z = np.asarray(p_P, dtype=float).T
        y = y + geometry.motor_radius
        rho, theta = np.hypot(y, z), np.arctan2(z, y)
        q = rho + geometry.array_radius - geometry.motor_radius
        depth, phi = np.hypot(q, x) - geometry.array_radius, np.arctan2(x, q)
        none, one = np.zeros_like(phi), np.ones_like(phi)
        within, turned = [np.sin(phi), np.cos(phi)], [np.cos(theta), np.sin(theta)]
        # Rows: along the array, across the frame, along the line.
        axes = np.array(
            [
                [within[1], -within[0] * turned[0], -within[0] * turned[1]],
                [none, -turned[1] * one, turned[0]],
                [within[0], within[1] * turned[0], within[1] * turned[1]],
            ]
        ).transpose(2, 0, 1)
        widths = np.stack(
            [np.interp(depth, self.depth, w) for w in (self.lateral, self.elevation, self.axial)],
            axis=-1,
        )
        scaled = axes * (widths / FWHM_PER_SIGMA)[..., np.newaxis]
        return np.asarray(scaled.swapaxes(1, 2) @ scaled)
