"""The leaf that sends a pose over a live connection."""

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.live.connection.items import PoseItem
from sonoservo.systems.live.estimate_items import Outlet
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive


class TransformSender(LeafSystem):
    """Sends a pose at a fixed rate.

    .. pydrake_system::

        name: TransformSender
        input_ports:
        - X_WP

    Parameters
    ----------
    outlet
        Where it goes.
    name
        Of its device.
    port
        Name of the input port: a RigidTransform.
    period, offset
        When it is sent, in s.
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
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._outlet, self._name, self._port = outlet, name, port
        self.DeclareAbstractInputPort(port, Value(RigidTransform()))
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _publish(self, context: Context) -> None:
        # A copy: an input's value changes in place.
        X = RigidTransform(evaluate(self, context, self._port, RigidTransform))
        self._outlet.send([PoseItem(self._name, context.get_time(), X)])
