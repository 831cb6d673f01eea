"""The leaf that sends the two slices along the needle that a scanner's monitor shows."""

import numpy as np
from pydrake.systems.framework import Context

from sonoservo.systems.live.connection.items import ImageItem, Item
from sonoservo.systems.live.sender import KEEP, Outlet, Sender
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.planes import sample_plane, slice_planes
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.volume import Volume

SLICES = ("SliceA_Probe", "SliceB_Probe")
"""Device names: the slice across the beam that contains the needle's depth, and the other one."""


def slice_items(volume: Volume, curve: NeedleCurve | None = None) -> list[Item]:
    """Return the two orthogonal slices in P through a needle in W, or else Z = 0 and X = 0."""
    items: list[Item] = []
    spacing = float(volume.spacing.min())
    for name, plane in zip(SLICES, slice_planes(volume, curve), strict=False):
        grey = sample_plane(volume, plane, spacing)
        rows, columns = grey.shape
        R = plane.X_PS.rotation().matrix()
        X_LI = np.eye(4)
        steps = [plane.width / columns, plane.height / rows, spacing]
        X_LI[:3] = np.column_stack([R * steps, plane.grid(rows, columns)[0, 0]])
        items.append(ImageItem(name, volume.time, grey.T[..., np.newaxis], X_LI))
    return items


class SliceSender(Sender):
    """Sends the two slices through each new volume that contain the estimated needle.

    .. pydrake_system::

        name: SliceSender
        input_ports:
        - volume
        - estimate

    Parameters
    ----------
    outlet
        Outlet that the slices go to.
    period, offset
        Period and offset of the look for a new volume, in s: a moment after the tracker's.
    """

    def __init__(self, *, outlet: Outlet, period: float, offset: float = 0.0) -> None:
        super().__init__(outlet=outlet, period=period, offset=offset)
        declare_inputs(self, volume=(Volume, NotFound), estimate=NeedleEstimate)

    def _publish(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        if isinstance(volume, Volume) and self._is_new(volume.time):
            self._outlet.send(slice_items(volume, estimate.curve), topic="slices", keep=KEEP)
