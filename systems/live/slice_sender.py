"""The leaf that sends the two slices along the needle that a scanner's monitor shows."""

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.live.connection.items import ImageItem, Item
from sonoservo.systems.live.estimate_items import Outlet
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume

SLICES = ("SliceA_Probe", "SliceB_Probe")
"""Device names: the slice across the beam that contains the needle's depth, and the other one."""

_KEEP = 2


def slice_items(volume: Volume, curve: NeedleCurve | None = None) -> list[Item]:
    """Return the two orthogonal slices through a volume that contain the needle, in P.

    Parameters
    ----------
    volume
        To cut.
    curve
        Needle in W; without one, the planes are Z = 0 and X = 0 of P.
    """
    items: list[Item] = []
    spacing = float(volume.spacing.min())
    for name, plane in zip(SLICES, slice_planes(volume, curve), strict=False):
        grey = sample_plane(volume, plane, spacing)[..., 0]
        rows, columns = grey.shape
        R = plane.X_PS.rotation().matrix()
        X_LI = np.eye(4)
        steps = [plane.width / columns, plane.height / rows, spacing]
        X_LI[:3] = np.column_stack([R * steps, plane.grid(rows, columns)[0, 0]])
        items.append(ImageItem(name, volume.time, grey.T[..., np.newaxis], X_LI))
    return items


class SliceSender(LeafSystem):
    """Sends the two slices through each new volume that contain the estimated needle.

    .. pydrake_system::

        name: SliceSender
        input_ports:
        - volume
        - estimate

    Parameters
    ----------
    outlet
        Where they go.
    period, offset
        When to look for a new volume, in s: a moment after the tracker has.
    """

    def __init__(self, *, outlet: Outlet, period: float, offset: float = 0.0) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._outlet = outlet
        self._start()
        for name in ("volume", "estimate"):
            self.DeclareAbstractInputPort(name, Value[object]())
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        self._volume_time = -float("inf")

    def _publish(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        if isinstance(volume, Volume) and volume.time > self._volume_time:
            self._volume_time = volume.time
            self._outlet.send(slice_items(volume, estimate.curve), topic="slices", keep=_KEEP)
