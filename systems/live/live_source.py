"""A stream of volumes from a live connection."""

import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Any, Protocol, Self

from sonoservo.systems.live.connection.items import Item
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.connection.protocols import Address
from sonoservo.systems.live.image_matcher import ImageMatcher, PosedImage
from sonoservo.systems.live.volume_maker import VolumeMaker
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.volume import Volume

_FRAMES_KEPT = 1024


class ImagesToVolumes(Protocol):
    """Maker of volumes from images.

    Attributes
    ----------
    takes_frames
        True if the images are 2D frames, many of which make a volume.
    """

    takes_frames: bool

    def __call__(self, posed: PosedImage) -> Volume | NotFound:
        """Return the volume that an image completes, or why there is none; empty if none is due."""
        ...

    def X_WL(self, posed: PosedImage) -> Any:
        """Pose of the sender's frame in W."""
        ...


class LiveSource:
    """The newest volumes of a connection.

    Parameters
    ----------
    address
        Address that they come from.
    maker
        Makes volumes of images; by default `VolumeMaker`, of images with several layers.
    poses
        Name of the device that is the probe's pose; see `ImageMatcher`.
    keep
        Number of volumes that wait while one is worked on; older ones are dropped.
    report
        Function that is called with one line for a person.
    """

    def __init__(
        self,
        address: Address,
        *,
        maker: ImagesToVolumes | None = None,
        poses: str | None = None,
        keep: int = 1,
        report: Callable[[str], None] = print,
    ) -> None:
        self._report = report
        self._maker: ImagesToVolumes = maker or VolumeMaker()
        self._matcher = ImageMatcher(
            device=address.device,
            poses=poses,
            layers=not self._maker.takes_frames,
            report=self._say,
        )
        self._images: deque[PosedImage] = deque()
        self._keep = _FRAMES_KEPT if self._maker.takes_frames else keep
        self._news = threading.Condition()
        self._said = ""
        self.link = Link(address, self._receive, report)
        self.dropped = 0
        self.newest: PosedImage | None = None

    def __enter__(self) -> Self:
        self.link.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.link.close()

    @property
    def address(self) -> Address:
        """Address that the volumes come from."""
        return self.link.address

    @property
    def posed(self) -> bool:
        """True if the stream tells the probe's poses."""
        return self._matcher.posed or bool(self.newest and self.newest.acquisition)

    @property
    def left_out(self) -> int:
        """Number of images that had no pose, or came out of order."""
        return self._matcher.left_out

    def X_WL(self) -> Any:
        """Pose of the sender's frame in W, when the last volume was acquired."""
        assert self.newest is not None
        return self._maker.X_WL(self.newest)

    def take(self, timeout: float = 0.0) -> Volume | NotFound:
        """Return the next volume, waiting for it at most ``timeout`` s, or why there is none."""
        end = time.perf_counter() + timeout
        while True:
            posed = self._next(end)
            if posed is None:
                return NotFound(f"no volume has come from {self.address}")
            volume = self._maker(posed)
            if isinstance(volume, Volume):
                self.newest = posed
                return volume
            if volume.reason:
                self._say(volume.reason)

    def _next(self, end: float) -> PosedImage | None:
        with self._news:
            while not self._images:
                left = end - time.perf_counter()
                self._keep_images(self._matcher.release(time.perf_counter()))
                if self._images:
                    break
                if left <= 0:
                    return None
                self._news.wait(min(left, 0.05))
            return self._images.popleft()

    def _receive(self, item: Item, arrived: float) -> None:
        with self._news:
            self._keep_images(self._matcher.feed(item, arrived))

    def _keep_images(self, images: list[PosedImage]) -> None:
        for image in images:
            self._images.append(image)
            if len(self._images) > self._keep:
                self._images.popleft()
                self.dropped += 1
        if images:
            self._news.notify_all()

    def _say(self, line: str) -> None:
        """Report a line once, not for each of the images that it is true of."""
        if line != self._said:
            self._said = line
            self._report(f"{self.link.address}: {line}")
