"""Resolution of an image: widths of the blur by the scanner, by depth."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]

FWHM_PER_SIGMA = float(2 * np.sqrt(2 * np.log(2)))
"""Ratio of the full width at half maximum of a Gaussian to its standard deviation."""


@dataclass(frozen=True, eq=False)
class PointSpread(Immutable):
    """Widths of a point's echo: full widths at half maximum by depth, in m."""

    depth: Annotated[Floats, Shape("n")]
    """Ascending distances from the array along a line. Between them the widths are interpolated,
    and beyond them they are constant."""

    lateral: Annotated[Floats, Shape("n")]
    """Widths along the array."""

    elevation: Annotated[Floats, Shape("n")]
    """Widths across the frame."""

    axial: Annotated[Floats, Shape("n")]
    """Widths along the line."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.depth) > 0, "depth", self.depth, "at least one depth")
        require(bool((np.diff(self.depth) > 0).all()), "depth", self.depth, "ascending")
        for name in ("lateral", "elevation", "axial"):
            widths = getattr(self, name)
            require(bool((widths > 0).all()), name, widths, "above 0")

    def widths(self, depth: Floats) -> Floats:
        """Return the (m, 3) lateral, elevation and axial widths in m at (m,) depths in m."""
        each = (self.lateral, self.elevation, self.axial)
        return np.stack([np.interp(depth, self.depth, widths) for widths in each], axis=-1)
