"""Leaf system that keeps every volume of a run in memory."""

from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks, declare_memory
from sonoservo.systems.signals.ports import declare_inputs, evaluate
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
        declare_inputs(self, volume=(Volume, NotFound))
        self._volumes = declare_memory(self, list[Volume])
        declare_looks(
            self, self._look, period=period, offset=offset,
            start=lambda context: self.volumes(context).clear(),
        )  # fmt: skip

    def volumes(self, context: Context) -> list[Volume]:
        """Return the volumes so far, in order of time."""
        return self._volumes(context)

    def _look(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        kept = self.volumes(context)
        if isinstance(volume, Volume) and not (kept and volume.time <= kept[-1].time):
            kept.append(volume)
