"""Measurement of the needle in one volume."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import check_bounds, within


@dataclass(frozen=True, eq=False)
class NeedleMeasurement(Immutable):
    """Needle found in one volume. If there is none, a `NotFound` takes its place.

    Parameters
    ----------
    curve
        Curve of the needle in W, in m.
    covariance
        (3n, 3n) covariance of the stacked control points, in m^2. Tip and interior points are
        correlated.
    time
        Time at which the tip was acquired, in s.
    inlier_count, inlier_ratio
        Number of candidate voxels within the residual threshold, and their share of the candidates
        between entry and tip.
    X_WP
        Pose of the probe from which the tip was seen; None if unknown.
    tip_seen
        Whether the end of the curve was seen to be the tip. If not, the needle may go on beyond it.
    bevel_std
        Standard deviation along the needle, in m, of an error of the tip that all measurements have
        in common, as long as the needle is turned as it is; not part of the covariance.
    """

    curve: NeedleCurve
    covariance: NDArray[np.float64]
    time: float
    inlier_count: int
    inlier_ratio: Annotated[float, within(0, 1)]
    X_WP: RigidTransform | None = None
    tip_seen: bool = True
    bevel_std: float = 0.0

    def __post_init__(self) -> None:
        size = 3 * self.curve.order
        object.__setattr__(
            self, "covariance", read_only(self.covariance, "covariance", (size, size))
        )
        check_bounds(self)
