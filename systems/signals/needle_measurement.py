"""What one volume says about the needle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import require


@dataclass(frozen=True, eq=False)
class NeedleMeasurement(Immutable):
    """The needle found in one volume. Where there is none, a `NotFound` takes its place.

    Parameters
    ----------
    curve
        In W, in m.
    covariance
        (3n, 3n) covariance of the stacked control points, in m^2; tip and interior points are
        correlated.
    time
        When the tip was acquired, in s.
    inlier_count, inlier_ratio
        Candidate voxels within the curve's inlier distance, and their share of all candidates.
    """

    curve: NeedleCurve
    covariance: NDArray[np.float64]
    time: float
    inlier_count: int
    inlier_ratio: float

    def __post_init__(self) -> None:
        size = 3 * self.curve.order
        object.__setattr__(
            self, "covariance", read_only(self.covariance, "covariance", (size, size))
        )
        require(0 <= self.inlier_ratio <= 1, "inlier_ratio", self.inlier_ratio, "from 0 to 1")
