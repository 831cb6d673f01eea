"""The leaf that keeps pictures of every volume, for the report and for movies."""

from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.evaluation.reports.track_plots import VolumePictures, picture_planes
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks, declare_memory
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.volume import Volume

_MOST = 400  # number of pictures above which every second one is dropped


class PictureRecorder(LeafSystem):
    """Keeps the two slices through the estimated needle of every new volume.

    .. pydrake_system::

        name: PictureRecorder
        input_ports:
        - volume
        - estimate

    A volume's pictures take 20 KB and 3 ms. Beyond 400, every second of the older ones is dropped.

    Parameters
    ----------
    period, offset
        Period of the checks for a new volume and time of the first one, in s.
    """

    def __init__(self, *, period: float, offset: float = 0.0) -> None:
        super().__init__()
        declare_inputs(self, volume=(Volume, NotFound), estimate=NeedleEstimate)
        self._pictures = declare_memory(self, list[VolumePictures])
        declare_looks(
            self, self._look, period=period, offset=offset,
            start=lambda context: self.pictures(context).clear(),
        )  # fmt: skip

    def pictures(self, context: Context) -> list[VolumePictures]:
        """Return the pictures so far, in order of time."""
        return self._pictures(context)

    def _look(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        kept = self.pictures(context)
        if not isinstance(volume, Volume) or (kept and volume.time <= kept[-1].time):
            return
        kept.append(picture_planes(volume, estimate.mode, estimate.curve))
        if len(kept) > _MOST:
            del kept[1 : _MOST // 2 : 2]
