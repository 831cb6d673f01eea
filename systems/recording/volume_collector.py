"""The leaf that keeps every volume of a run in memory."""

from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem, ValueProducer

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume


class VolumeCollector(LeafSystem):
    """Keeps every new volume in memory, to judge a short run by what it showed.

    .. pydrake_system::

        name: VolumeCollector
        input_ports:
        - volume

    `volume` holds a Volume or a NotFound. The volumes are kept in the context and cleared whenever
    a simulator is initialised; `VolumeRecorder` writes them to disk instead.

    Parameters
    ----------
    period, offset
        Period of the checks for a new volume and time of the first one, in s: shortly after the
        tracker's events.
    """

    def __init__(self, *, period: float, offset: float = 0.0) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        declare_inputs(self, volume=(Volume, NotFound))
        self._volumes = self.DeclareCacheEntry(
            "volumes",
            ValueProducer(lambda: Value[object]([]), ValueProducer.NoopCalc),
            {self.nothing_ticket()},
        )
        self.DeclareInitializationPublishEvent(lambda context: self.volumes(context).clear())
        self.DeclarePeriodicPublishEvent(period, offset, self._look)
        self.DeclareForcedPublishEvent(self._look)

    def volumes(self, context: Context) -> list[Volume]:
        """Return the volumes so far, in order of time."""
        kept: list[Volume] = self._volumes.get_mutable_cache_entry_value(
            context
        ).GetMutableValueOrThrow()
        return kept

    def _look(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        kept = self.volumes(context)
        if isinstance(volume, Volume) and not (kept and volume.time <= kept[-1].time):
            kept.append(volume)
