"""Prediction of the needle in a volume, before the volume is seen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import require


@dataclass(frozen=True, eq=False)
class NeedlePrediction(Immutable):
    """Needle that a tracker expects in a volume. If it expects none, a `NotFound` takes its place.

    The prediction follows from earlier volumes and from the time and pose of its volume, never from
    a measurement in that volume.

    Parameters
    ----------
    order
        Number n of control points of the curve to be measured.
    time
        Time of the prediction in s. It is the volume's time, or that of the last estimate if the
        needle is lost.
    curve
        Expected curve in W, in m; None if nothing is known about the needle.
    velocity
        (n, 3) velocities of the control points in W, in m/s; None without a curve.
    covariance
        (3n, 3n) covariance of the stacked control points, in m^2; None without a curve.
    entry
        (3,) last measured position of the entry in W, in m; None while the entry is a guess.
    missed
        Number of successive volumes that did not confirm the needle.
    everywhere
        Whether the whole volume is searched, because the needle was lost or never seen.
    found
        Whether the curve is a line that was found in the volume itself, of which nothing else is
        known.

    Raises
    ------
    ValueError
        If an array has the wrong shape, if the curve has another order, or if there is no curve
        although the search is not everywhere.
    """

    order: int
    time: float
    curve: NeedleCurve | None = None
    velocity: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    entry: NDArray[np.float64] | None = None
    missed: int = 0
    everywhere: bool = False
    found: bool = False

    def __post_init__(self) -> None:
        if self.curve is None:
            require(self.everywhere, "everywhere", self.everywhere, "true without a curve")
            return
        n = self.order
        require(self.curve.order == n, "curve.order", self.curve.order, f"order, {n}")
        for name, shape in (("velocity", (n, 3)), ("covariance", (3 * n, 3 * n))):
            object.__setattr__(self, name, read_only(getattr(self, name), name, shape))
        if self.entry is not None:
            object.__setattr__(self, "entry", read_only(self.entry, "entry", (3,)))
