"""Inserted part of a real needle."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import Positive, require


@dataclass(frozen=True, eq=False)
class Needle(Immutable):
    """Inserted part of a needle; falsy while the needle is outside."""

    shaft: Annotated[NDArray[np.float64], Shape(None, 3)]
    """Points along the needle's axis in m, from the entry to the tip; none while it is outside."""

    radius: Positive
    """Outer radius in m."""

    aim: Annotated[NDArray[np.float64], Shape(2, 3)] | None = None
    """Tip and a point at which the needle is aimed while it is outside, in m. None while it is
    inside, or if unknown. It is used for display only."""

    roll: float = 0.0
    """Angle of the bevel's face about the axis in rad: at 0 it looks up, at pi/2 across the needle,
    to the left as seen along it. It matters to how the tip echoes."""

    track: Annotated[NDArray[np.float64], Shape(2, 3)] | None = None
    """Ends of the channel that the needle left beyond its tip as it was withdrawn, deepest last, in
    m; None if there is none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.shaft) != 1, "shaft", len(self.shaft), "0 or at least 2 points")
        outside = self.aim is None or not len(self.shaft)
        require(outside, "aim", self.aim, "None while the needle is inside")

    def __bool__(self) -> bool:
        return len(self.shaft) > 0

    @property
    def tip(self) -> NDArray[np.float64]:
        """(3,) position of the tip in m."""
        return self.shaft[-1]

    @cached_property
    def _steps(self) -> NDArray[np.float64]:
        """Distances between successive points of the shaft, in m."""
        steps = self.shaft[1:] - self.shaft[:-1]
        return np.sqrt((steps * steps).sum(axis=1))

    @property
    def length(self) -> float:
        """Inserted length along the shaft, in m."""
        return float(self._steps.sum())

    @property
    def curve(self) -> NeedleCurve:
        """Straight curve from entry to tip (order 2)."""
        return NeedleCurve(self.shaft[[0, -1]])

    def position(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 3) positions in m at distances s along the shaft from the entry in m."""
        ends = np.concatenate([[0], self._steps.cumsum()])
        s = np.asarray(s, dtype=float)
        return np.stack([np.interp(s, ends, axis) for axis in self.shaft.T], axis=-1)

    def transformed(self, X: RigidTransform) -> "Needle":
        """Return the needle expressed in another frame."""
        shaft, aim, track = (
            None if points is None else X.multiply(points.T).T
            for points in (self.shaft if self else None, self.aim, self.track)
        )
        shaft = self.shaft if shaft is None else shaft
        return Needle(shaft, self.radius, aim, self.roll, track)
