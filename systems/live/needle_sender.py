"""The leaf that sends each new estimate of the needle over a live connection."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context

from sonoservo.systems.live.connection.items import (
    CovarianceItem,
    CurveItem,
    Item,
    PointsItem,
    PoseItem,
    StatusItem,
)
from sonoservo.systems.live.sender import Outlet, Sender
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.requirements import require

_POINTS = 21


@dataclass(frozen=True, kw_only=True)
class NeedleNames:
    """Device names of what is told about a needle; 1 to 20 bytes long, empty leaves it out.

    Parameters
    ----------
    tip
        TRANSFORM with its origin at the tip and Z along the needle.
    curve
        POLYDATA with the needle as a line, or POINT with its control points if ``points``.
    status
        STATUS with mode and reason.
    covariance
        NDARRAY with the covariance of the tip.
    points
        True to send the curve as points.
    """

    tip: str = "NeedleTipToReference"
    curve: str = "Needle"
    status: str = "NeedleStatus"
    covariance: str = "NeedleTipCovariance"
    points: bool = False

    def __post_init__(self) -> None:
        for field in ("tip", "curve", "status", "covariance"):
            name = getattr(self, field)
            require(len(name.encode()) <= 20, field, name, "at most 20 bytes long")


def tip_pose(curve: NeedleCurve) -> RigidTransform:
    """Return the pose of the tip's frame: origin at the tip, Z along the needle there."""
    return RigidTransform(RotationMatrix.MakeFromOneVector(curve.tangent(1.0), 2), curve.tip)


def curve_points(curve: NeedleCurve) -> NDArray[np.float64]:
    """Return (m, 3) points along a needle that look like it, in m."""
    return curve.position(np.linspace(0, 1, 2 if curve.order == 2 else _POINTS))


def needle_items(estimate: NeedleEstimate, names: NeedleNames, time: float) -> list[Item]:
    """Return what is to be sent about an estimate; of a needle that is not known, its status.

    Parameters
    ----------
    estimate
        In W.
    names
        Names of the devices.
    time
        Time stamp of the image that it belongs to, in s.
    """
    good = estimate.mode is TrackingMode.TRACKING
    text = f"{estimate.mode}: {estimate.reason}" if estimate.reason else str(estimate.mode)
    items: list[Item] = [StatusItem(names.status, time, good, text)]
    if estimate.curve is not None:
        curve = estimate.curve
        shape = (
            PointsItem(names.curve, time, curve.control_points)
            if names.points
            else CurveItem(names.curve, time, curve_points(curve))
        )
        items += [
            PoseItem(names.tip, time, tip_pose(curve)),
            shape,
            CovarianceItem(names.covariance, time, estimate.tip_covariance),
        ]
    return [item for item in items if item.name]


class NeedleSender(Sender):
    """Sends each new estimate, with the time of the volume that it belongs to.

    .. pydrake_system::

        name: NeedleSender
        input_ports:
        - estimate

    `estimate` is a `NeedleEstimate` in W.

    Parameters
    ----------
    outlet
        Outlet that the messages go to.
    names
        Names of the devices.
    period, offset
        Period and offset of the look for a new estimate, in s: a moment after the tracker made it.
    """

    def __init__(
        self,
        *,
        outlet: Outlet,
        names: NeedleNames | None = None,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__(outlet=outlet, period=period, offset=offset)
        self._names = names or NeedleNames()
        declare_inputs(self, estimate=NeedleEstimate)

    def _publish(self, context: Context) -> None:
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        if self._is_new(estimate.volume_time):
            self._outlet.send(
                needle_items(estimate, self._names, estimate.volume_time), topic="estimate"
            )
