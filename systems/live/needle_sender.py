"""The leaf that sends each new estimate of the needle over a live connection."""

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.live.estimate_items import NeedleNames, Outlet, needle_items
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive


class NeedleSender(LeafSystem):
    """Sends each new estimate, with the time of the volume that it belongs to.

    .. pydrake_system::

        name: NeedleSender
        input_ports:
        - estimate

    `estimate` is a `NeedleEstimate` in W.

    Parameters
    ----------
    outlet
        Where they go.
    names
        Of the devices.
    period, offset
        When to look for a new estimate, in s: a moment after the tracker has made it.
    """

    def __init__(
        self,
        *,
        outlet: Outlet,
        names: NeedleNames | None = None,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._outlet, self._names = outlet, names or NeedleNames()
        self._start()
        self.DeclareAbstractInputPort("estimate", Value[object]())
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        self._volume_time = -float("inf")

    def _publish(self, context: Context) -> None:
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        if estimate.volume_time > self._volume_time:
            self._volume_time = estimate.volume_time
            self._outlet.send(
                needle_items(estimate, self._names, estimate.volume_time), topic="estimate"
            )
