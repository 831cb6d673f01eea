"""The leaf that shows each new volume on a scanner's monitor."""

from typing import TYPE_CHECKING

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:  # a run without a monitor does not import the package meshcat, which is slow
    from sonoservo.systems.display.monitor.monitor import Monitor


class ScannerMonitor(LeafSystem):
    """Shows each new volume, and the estimated needle in it, on a monitor.

    .. pydrake_system::

        name: ScannerMonitor
        input_ports:
        - volume
        - estimate (optional)

    `volume` is a `Volume`, or a `NotFound` while there is none, and `estimate` a `NeedleEstimate`.
    Volumes are counted from 1 in each run.

    Parameters
    ----------
    monitor
        Monitor to show the volumes on.
    period, offset
        Period of the checks for a new volume and time of the first one, in s: shortly after the
        tracker's.
    """

    def __init__(self, *, monitor: "Monitor", period: float, offset: float = 0.0) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._monitor = monitor
        self._start()
        for name in ("volume", "estimate"):
            self.DeclareAbstractInputPort(name, Value[object]())
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        self._volume_time = -float("inf")
        self._number = 0

    def _publish(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        if not isinstance(volume, Volume) or volume.time <= self._volume_time:
            return
        estimate = None
        if self.GetInputPort("estimate").HasValue(context):
            estimate = evaluate(self, context, "estimate", NeedleEstimate)
        self._volume_time = volume.time
        self._number += 1
        self._monitor.show(volume, estimate, self._number)
