"""The leaf that sends the frames of each sweep as they were acquired."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context

from sonoservo.systems.live.connection.items import ImageItem, Item, PoseItem
from sonoservo.systems.live.image_matcher import DEFAULT_POSES
from sonoservo.systems.live.sender import KEEP, Outlet, Sender
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.sweep import Sweep

FRAME = "Frame"


def frame_items(sweep: Sweep, name: str = FRAME) -> list[Item]:
    """Return a sweep's frames in order of time, as (samples, lines, 1) images, each after its pose.

    A sector is no grid: the matrix tells the distance between samples; lines count as 1 mm apart.
    """
    X_LI = np.diag([sweep.geometry.sample_pitch, 1e-3, 1e-3, 1.0])
    items: list[Item] = []
    for number in np.argsort(sweep.motion.times):
        time = float(sweep.motion.times[number])
        X_WP = RigidTransform(sweep.motion.X_WP[number])
        items.append(PoseItem(DEFAULT_POSES, time, X_WP))
        items.append(ImageItem(name, time, sweep.samples[number].T[..., np.newaxis], X_LI))
    return items


class SweepSender(Sender):
    """Sends the frames of each new sweep, with their own times and poses.

    .. pydrake_system::

        name: SweepSender
        input_ports:
        - sweep

    `sweep` is a `Sweep`, or a `NotFound` while there is none.

    Parameters
    ----------
    outlet
        Outlet that the frames go to.
    name
        Name of the frames' device.
    period, offset
        Period and offset of the look for a new sweep, in s.
    """

    def __init__(
        self, *, outlet: Outlet, name: str = FRAME, period: float, offset: float = 0.0
    ) -> None:
        super().__init__(outlet=outlet, period=period, offset=offset)
        self._name = name
        declare_inputs(self, sweep=(Sweep, NotFound))

    def _publish(self, context: Context) -> None:
        sweep = evaluate(self, context, "sweep", (Sweep, NotFound))
        if isinstance(sweep, Sweep) and self._is_new(sweep.motion.time):
            self._outlet.send(frame_items(sweep, self._name), topic="frames", keep=KEEP)
