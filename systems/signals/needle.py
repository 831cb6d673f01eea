"""Inserted part of a real needle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import Positive, check_bounds, require


@dataclass(frozen=True, eq=False)
class Needle(Immutable):
    """Inserted part of a needle; falsy while the needle is outside.

    Parameters
    ----------
    shaft
        (m, 3) points along the needle's axis in m, from the entry to the tip; (0, 3) while the
        needle is outside.
    radius
        Outer radius in m.
    aim
        (2, 3) tip and a point at which the needle is aimed while it is outside, in m. None while it
        is inside, or if unknown. It is used for display only.
    roll
        Angle of the bevel's face about the axis in rad: at 0 it looks up, at pi/2 across the
        needle, to the left as seen along it. It matters to how the tip echoes.
    track
        (2, 3) ends of the channel that the needle left beyond its tip as it was withdrawn, deepest
        last, in m; None if there is none.
    """

    shaft: NDArray[np.float64]
    radius: Positive
    aim: NDArray[np.float64] | None = None
    roll: float = 0.0
    track: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        shaft = read_only(self.shaft, "shaft", (None, 3))
        require(len(shaft) != 1, "shaft", len(shaft), "0 or at least 2 points")
        object.__setattr__(self, "shaft", shaft)
        if self.aim is not None:
            require(not len(shaft), "aim", self.aim, "None while the needle is inside")
            object.__setattr__(self, "aim", read_only(self.aim, "aim", (2, 3)))
        if self.track is not None:
            object.__setattr__(self, "track", read_only(self.track, "track", (2, 3)))
        check_bounds(self)

    def __bool__(self) -> bool:
        return len(self.shaft) > 0

    @property
    def tip(self) -> NDArray[np.float64]:
        """(3,) position of the tip in m."""
        return self.shaft[-1]

    @property
    def length(self) -> float:
        """Inserted length along the shaft, in m."""
        return float(np.linalg.norm(np.diff(self.shaft, axis=0), axis=1).sum())

    @property
    def curve(self) -> NeedleCurve:
        """Straight curve from entry to tip (order 2)."""
        return NeedleCurve(self.shaft[[0, -1]])

    def position(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 3) positions in m at distances s along the shaft from the entry in m."""
        ends = np.concatenate([[0], np.linalg.norm(np.diff(self.shaft, axis=0), axis=1).cumsum()])
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
