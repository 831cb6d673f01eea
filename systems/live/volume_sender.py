"""The leaf that sends each new volume over a live connection."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from sonoservo.systems.live.acquisition import acquisition_item
from sonoservo.systems.live.connection.items import ImageItem, Item, PoseItem
from sonoservo.systems.live.image_matcher import DEFAULT_POSES
from sonoservo.systems.live.sender import KEEP, Outlet, Sender
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.volume import Volume

IMAGE = "Image_Probe"
"""In 3D Slicer and PLUS, an image whose coordinates are those of the probe."""


def volume_items(
    volume: Volume, name: str = IMAGE, settings: Mapping[str, Any] | None = None
) -> list[Item]:
    """Return a volume as messages: how it was acquired, the probe's pose, and the image itself.

    Parameters
    ----------
    volume
        Volume to send; a voxel lies in L where it lies in P.
    name
        Name of its device.
    settings
        Settings of the scanner.
    """
    X_LI = np.eye(4)
    X_LI[:3] = np.column_stack([np.diag(volume.spacing), volume.origin])
    return [
        acquisition_item(volume, settings or {}),
        PoseItem(DEFAULT_POSES, volume.time, volume.X_WP),
        ImageItem(name, volume.time, volume.intensities, X_LI),
    ]


class VolumeSender(Sender):
    """Sends each new volume, the probe's pose with it, and how it was acquired.

    .. pydrake_system::

        name: VolumeSender
        input_ports:
        - volume

    `volume` is a `Volume`, or a `NotFound` while there is none. A receiver that is too slow gets
    the newest.

    Parameters
    ----------
    outlet
        Outlet that the messages go to.
    name
        Name of the image's device.
    settings
        Settings of the scanner, for receivers of this package.
    period, offset
        Period and offset of the look for a new volume, in s.
    """

    def __init__(
        self,
        *,
        outlet: Outlet,
        name: str = IMAGE,
        settings: Mapping[str, Any] | None = None,
        period: float,
        offset: float = 0.0,
    ) -> None:
        super().__init__(outlet=outlet, period=period, offset=offset)
        self._name, self._settings = name, settings
        declare_inputs(self, volume=(Volume, NotFound))

    def _publish(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        if isinstance(volume, Volume) and self._is_new(volume.time):
            self._outlet.send(
                volume_items(volume, self._name, self._settings), topic="volume", keep=KEEP
            )
