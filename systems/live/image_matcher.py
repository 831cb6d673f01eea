"""Matching of images and poses as their messages arrive."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.systems.live import acquisition
from sonoservo.systems.live.acquisition import VolumeAcquisition, read_acquisition_item
from sonoservo.systems.live.connection.items import ImageItem, Item, PoseItem, TextItem
from sonoservo.systems.live.pose_history import PoseHistory
from sonoservo.systems.signals.immutable import Immutable, NotFound

DEFAULT_POSES = "ProbeToReference"

_SAME = 1e-6
"""Time stamps in s that differ by less are the same."""

_WAIT, _FIRST_WAIT = 0.15, 0.5
"""Time in s that an image waits for its pose; the first one, to see whether there are poses."""

_BACKWARDS, _FORWARDS = 1.0, 60.0
"""A time stamp in s that jumps further is that of a clock that was set anew."""

_REMEMBERED = 8


@dataclass(frozen=True, eq=False)
class PosedImage(Immutable):
    """An image and the pose that the sender's frame L had.

    Parameters
    ----------
    image
        Image as received.
    X_WL
        Pose of L in the reference frame W; identity for a probe at rest.
    acquisition
        Acquisition, if a scanner of this package sent it.
    time
        Time in s; unlike the image's own time stamp, it never runs backwards.
    arrived
        Time of arrival of the last byte, by `time.perf_counter`.
    """

    image: ImageItem
    X_WL: RigidTransform
    acquisition: VolumeAcquisition | None
    time: float
    arrived: float


class ImageMatcher:
    """Puts images and poses together that have the same time stamp, or nearly.

    An image waits until a pose at its time or later is there, so that it can be interpolated, but
    not for long. If poses are neither asked for nor there when the first image comes, the probe is
    taken to be at rest from then on.

    Parameters
    ----------
    device
        Device whose images are taken; empty for the one whose image arrives first.
    poses
        Device whose transforms are the pose of L; "none" for a probe at rest. By default
        ``ProbeToReference``, if there is such a device.
    layers
        True to take volumes, False to take 2D frames.
    report
        Function that is called with one line for a person.
    """

    def __init__(
        self,
        *,
        device: str = "",
        poses: str | None = None,
        layers: bool = True,
        report: Callable[[str], None] = print,
    ) -> None:
        self._device, self._layers, self._report = device, layers, report
        self._pose_name = poses or DEFAULT_POSES
        self._posed = {None: None, "none": False}.get(poses, True)
        self._poses = PoseHistory()
        self._waiting: list[tuple[ImageItem, float]] = []
        self._said: OrderedDict[float, VolumeAcquisition] = OrderedDict()
        self._last: float | None = None
        self._step, self._shift = 0.1, 0.0
        self.left_out = 0

    @property
    def posed(self) -> bool:
        """True if images have poses."""
        return bool(self._posed)

    def feed(self, item: Item, now: float) -> list[PosedImage]:
        """Take in an item that arrived ``now``; return the images that it completes."""
        if isinstance(item, PoseItem) and item.name == self._pose_name:
            self._poses.add(item.time, item.X)
        elif isinstance(item, TextItem) and item.name == acquisition.NAME:
            self._note(item)
        elif isinstance(item, ImageItem) and self._is_wanted(item):
            self._waiting = [*self._waiting[-31:], (item, now)]
        return self.release(now)

    def release(self, now: float) -> list[PosedImage]:
        """Return the images that need not, or may not, wait any longer."""
        ready: list[PosedImage] = []
        while self._waiting and (image := self._complete(*self._waiting[0], now)) is not None:
            self._waiting.pop(0)
            if isinstance(image, NotFound):
                self.left_out += 1
                self._report(f"an image is left out: {image.reason}")
            else:
                ready.append(image)
        return ready

    def _is_wanted(self, image: ImageItem) -> bool:
        if (min(image.voxels.shape) > 1) != self._layers:
            if self._device == image.name:
                size = " x ".join(map(str, image.voxels.shape))
                self._report(
                    f"{image.name}: {size} numbers are no volume; --reconstruct makes volumes of "
                    "2D frames"
                    if self._layers
                    else f"{image.name}: {size} numbers are no 2D frame"
                )
            return False
        if not self._device:
            self._device = image.name
        return image.name == self._device

    def _note(self, item: TextItem) -> None:
        try:
            said = read_acquisition_item(item)
            self._said[said.time] = said
        except ValueError as error:
            self._report(f"a text is left out: {error}")
        while len(self._said) > _REMEMBERED:
            self._said.popitem(last=False)

    def _complete(
        self, image: ImageItem, arrived: float, now: float
    ) -> PosedImage | NotFound | None:
        """Return the image with its pose, why it is left out, or None if it should wait."""
        X_WL: RigidTransform | NotFound
        stamp = image.time
        said = next((v for v in self._said.values() if abs(v.time - stamp) < _SAME), None)
        if said is not None:
            stamp, X_WL = said.time, said.X_WP
        elif self._posed is False:
            X_WL = RigidTransform()
        elif self._posed is None and not len(self._poses):
            if now - arrived < _FIRST_WAIT:
                return None
            self._posed = False
            self._report(f"there is no device {self._pose_name!r}: the probe counts as at rest")
            X_WL = RigidTransform()
        else:
            self._posed = True
            if not self._poses.reaches(stamp) and now - arrived < _WAIT:
                return None
            X_WL = self._poses.at(stamp)
        if isinstance(X_WL, NotFound):
            return X_WL
        time = self._steady(stamp)
        if time is None:
            return NotFound(f"its time stamp {stamp:.6f} s is not later than the last one's")
        return PosedImage(image, X_WL, said, time, arrived)

    def _steady(self, stamp: float) -> float | None:
        """Return a time that goes on where a clock was set anew; None for one that is late."""
        time = stamp + self._shift
        if self._last is None:
            self._last = time
            return time
        step = time - self._last
        if not -_BACKWARDS < step < _FORWARDS:
            self._report(f"the sender's clock jumped by {step:+.3f} s; the stream goes on")
            time = self._last + self._step
            self._shift = time - stamp
        elif step <= 0:
            return None
        else:
            self._step = float(np.clip(step, 1e-3, 1.0))
        self._last = time
        return time
