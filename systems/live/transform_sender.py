"""The leaf that sends a pose over a live connection."""

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from sonoservo.systems.live.connection.items import PoseItem
from sonoservo.systems.live.sender import Outlet, Sender
from sonoservo.systems.signals.ports import evaluate


class TransformSender(Sender):
    """Sends a pose at a fixed rate.

    .. pydrake_system::

        name: TransformSender
        input_ports:
        - X_WP

    Parameters
    ----------
    outlet
        Outlet that the pose goes to.
    name
        Name of its device.
    port
        Name of the input port: a RigidTransform.
    period, offset
        Period and offset of the messages, in s.
    """

    def __init__(
        self,
        *,
        outlet: Outlet,
        name: str,
        port: str = "X_WP",
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__(outlet=outlet, period=period, offset=offset)
        self._name, self._port = name, port
        self.DeclareAbstractInputPort(port, Value(RigidTransform()))

    def _publish(self, context: Context) -> None:
        # A copy: an input's value changes in place.
        X = RigidTransform(evaluate(self, context, self._port, RigidTransform))
        self._outlet.send([PoseItem(self._name, context.get_time(), X)])
