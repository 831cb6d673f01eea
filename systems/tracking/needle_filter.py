"""Interface of a needle filter, and the registry of all needle filters."""

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter
from sonoservo.systems.tracking.control_point_filter import ControlPointFilter
from sonoservo.systems.tracking.interacting_filter import InteractingFilter


class NeedleState(Protocol):
    """A filter's belief about the needle at one time; immutable."""

    @property
    def time(self) -> float:
        """Time for which the state holds, in s."""

    @property
    def curve(self) -> NeedleCurve:
        """Mean of the n control points in W, in m."""

    @property
    def velocity(self) -> NDArray[np.float64]:
        """(n, 3) mean velocities of the control points in W, in m/s."""

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(6n, 6n) covariance of the stacked control points and their velocities."""

    def transformed(self, X: RigidTransform) -> Self:
        """Return the state moved by a rigid transform, with its velocities rotated."""


S = TypeVar("S", bound=NeedleState)


class NeedleFilter(Protocol[S]):
    """Model of a needle's motion, and of its correction by measurements.

    A filter has no memory and takes no decisions. The `TrackManager` decides which measurements to
    accept and when a needle is lost. The fields of a filter are its parameters, and a YAML file can
    choose and set a filter.
    """

    orders: ClassVar[tuple[int, ...]]
    """Numbers of control points that the filter supports."""

    def start(self, measurement: NeedleMeasurement) -> S:
        """Return the state after a first measurement, with an unknown velocity."""

    def predict(self, state: S, time: float) -> S:
        """Return the state at a later time in s; an earlier time changes nothing."""

    def update(
        self,
        state: S,
        measurement: NeedleMeasurement | None,
        velocity: VelocityMeasurement | None,
    ) -> S:
        """Return the state corrected by measurements at its time; each of them may be missing."""


FILTERS: tuple[type, ...] = (InteractingFilter, ControlPointFilter, AxisTipFilter)
"""All needle filters; a new one needs a file and an entry here."""

if TYPE_CHECKING:
    AnyFilter = NeedleFilter[Any]
else:
    AnyFilter = reduce(or_, FILTERS)
    """Type of a YAML field whose ``kind`` chooses the filter."""


def require_order(order: int, needle_filter: NeedleFilter[Any]) -> None:
    """Raise ValueError unless a filter supports curves of an order."""
    orders = needle_filter.orders
    names = {2: "straight", 3: "bent"}
    allowed = " or ".join(f"{each} ({names[each]})" for each in orders)
    require(order in orders, "order", order, allowed)
