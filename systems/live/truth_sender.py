"""The leaf that sends what only a simulation knows: the true needle."""

from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.framework import Context

from sonoservo.systems.live.connection.items import CurveItem, Item, PoseItem
from sonoservo.systems.live.sender import Outlet, Sender
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.ports import declare_inputs, evaluate

TIP, NEEDLE, TISSUE = "TrueTipToReference", "TrueNeedle", "TrueTissueToRef"
"""Device names; trackers take none that begins with True."""

_TIP_LENGTH = 1e-3
"""Length in m over which the direction at the tip is taken."""


def truth_items(needle: Needle, X_WT: RigidTransform, time: float) -> list[Item]:
    """Return the truth as messages: the needle in T and the pose of T, at a time in s."""
    items: list[Item] = [PoseItem(TISSUE, time, RigidTransform(X_WT))]
    if needle:
        moved = needle.transformed(X_WT)
        along = moved.tip - moved.position(moved.length - min(_TIP_LENGTH, moved.length))
        items.append(CurveItem(NEEDLE, time, moved.shaft))
        if along.any():
            X_WTip = RigidTransform(RotationMatrix.MakeFromOneVector(along, 2), moved.tip)
            items.append(PoseItem(TIP, time, X_WTip))
    return items


class TruthSender(Sender):
    """Sends the true needle and the tissue's pose, under names that say so.

    .. pydrake_system::

        name: TruthSender
        input_ports:
        - needle
        - X_WT

    Parameters
    ----------
    outlet
        Outlet that the messages go to.
    period, offset
        Period and offset of the messages, in s.
    """

    def __init__(self, *, outlet: Outlet, period: float, offset: float = 0.0) -> None:
        super().__init__(outlet=outlet, period=period, offset=offset)
        declare_inputs(self, needle=Needle)
        self.DeclareAbstractInputPort("X_WT", Value(RigidTransform()))

    def _publish(self, context: Context) -> None:
        needle = evaluate(self, context, "needle", Needle)
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        self._outlet.send(truth_items(needle, X_WT, context.get_time()), topic="truth")
