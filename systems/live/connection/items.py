"""Items that travel over a live connection, whatever its protocol; SI units, positions in LPS.

The other program's frame is called L: LPS in m. Protocols convert from and to their own units and
axes; nothing outside of them knows mm or RAS.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable


@dataclass(frozen=True, eq=False)
class Item(Immutable):
    """One message: the sending device's name, and the time of measurement in s, by its clock."""

    name: str
    time: float


@dataclass(frozen=True, eq=False)
class ImageItem(Item):
    """(ni, nj, nk) voxels, or a frame of one layer; X_LI is (4, 4), from indices to L in m."""

    voxels: NDArray[Any]
    X_LI: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PoseItem(Item):
    """A rigid motion: ``ProbeToReference`` maps positions in the probe's L to the reference's."""

    X: RigidTransform


@dataclass(frozen=True, eq=False)
class CurveItem(Item):
    """(n, 3) points along a curve, in m."""

    points: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointsItem(CurveItem):
    """Points, each by itself."""


@dataclass(frozen=True, eq=False)
class TextItem(Item):
    """A text."""

    text: str


@dataclass(frozen=True, eq=False)
class StatusItem(Item):
    """A state, good or not, and a sentence about it."""

    good: bool
    text: str


@dataclass(frozen=True, eq=False)
class CovarianceItem(Item):
    """(3, 3) covariance of a position, in m^2."""

    covariance: NDArray[np.float64]
