"""Prediction of the needle in a volume, before the volume is seen."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, Shape, Vector3
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.tissue_record import TissueRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NeedlePrediction(Immutable):
    """Needle that a tracker expects in a volume. If it expects none, a `NotFound` takes its place.

    The prediction follows from earlier volumes and from the time and pose of its volume, never from
    a measurement in that volume.
    """

    order: int
    """Number n of control points of the curve to be measured."""

    time: float
    """Time of the volume, or that of the last estimate if the needle is lost, in s."""

    curve: NeedleCurve | None = None
    """Expected curve in W, in m; None, as the next two, if nothing is known about the needle."""

    velocity: Annotated[Floats, Shape("n", 3)] | None = None
    """Velocities of the control points in W, in m/s."""

    covariance: Annotated[Floats, Shape("3n", "3n")] | None = None
    """Covariance of the stacked control points, in m^2."""

    entry: Vector3 | None = None
    """Last measured position of the entry in W, in m; None while the entry is a guess."""

    tissue: TissueRecord | None = None
    """Tissue along the needle from before it came; None if unknown."""

    missed: int = 0
    """Number of successive volumes that did not confirm the needle."""

    everywhere: bool = False
    """Whether the whole volume is searched, because the needle was lost or never seen."""

    found: bool = False
    """Whether the curve is a line that was found in the volume itself, of which nothing else is
    known."""

    def __post_init__(self) -> None:
        n = self.order
        if self.curve is None:
            require(self.everywhere, "everywhere", self.everywhere, "true without a curve")
        else:
            require(self.curve.order == n, "curve.order", self.curve.order, f"order, {n}")
        super().__post_init__()

    def _extents(self) -> dict[str, int]:
        return {"n": self.order}
