"""A stream of volumes from a live connection."""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Self

from pydrake.math import RigidTransform

from sonoservo.systems.live.connection.address import Address
from sonoservo.systems.live.connection.items import Item
from sonoservo.systems.live.connection.link import Link
from sonoservo.systems.live.image_matcher import (
    ImageMatcher,
    LeftOut,
    PosedImage,
    least,
    too_many,
)
from sonoservo.systems.live.volume_maker import ImagesToVolumes, VolumeMaker
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.volume import Volume

_FRAMES_KEPT, _FIRST_KEPT, _TIMES = 1024, 64, 2000


class LiveSource:
    """The newest volumes of a connection.

    A ``maker`` makes them of images, by default `VolumeMaker`; see `ImageMatcher` for ``poses`` and
    ``clock_offset``. While one is worked on, ``keep`` wait, and older ones are dropped. Until the
    first has been worked on, which may compile what it needs, up to 64 wait, and are caught up on.

    `dropped` counts images that newer ones replaced; `times` are those of the last images that
    came, in s; `newest` is the image of the last volume taken.
    """

    def __init__(
        self,
        address: Address,
        *,
        maker: ImagesToVolumes | None = None,
        poses: str | None = None,
        keep: int = 1,
        clock_offset: float | None = None,
        report: Callable[[str], None] = print,
    ) -> None:
        self._maker: ImagesToVolumes = maker or VolumeMaker()
        self._matcher = ImageMatcher(
            device=address.device,
            poses=poses,
            layers=not self._maker.takes_frames,
            clock_offset=clock_offset,
            report=self._say,
        )
        self._images: deque[PosedImage] = deque()
        self._keep = _FRAMES_KEPT if self._maker.takes_frames else keep
        self._news = threading.Condition()
        self._said = ""
        self._proved: set[tuple[str, str]] = set()
        self._no_volume = self._taken = 0
        self.link = Link(address, self._receive, report)
        self.dropped = 0
        self.times: deque[float] = deque(maxlen=_TIMES)
        self.newest: PosedImage | None = None

    def __enter__(self) -> Self:
        self.link.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.link.close()

    @property
    def address(self) -> Address:
        """Address that the volumes come from."""
        return self.link.address

    @property
    def posed(self) -> bool:
        """True if the stream tells the probe's poses, by themselves or by the images' matrices."""
        return self._matcher.posed or self._maker.posed

    @property
    def left_out(self) -> Counter[str]:
        """Numbers of images and messages that were left out, by the reason."""
        counts = Counter(self._matcher.left_out)
        counts[LeftOut.DAMAGED] += self.link.refused
        counts[LeftOut.NO_VOLUME] += self._no_volume
        return Counter({why.value: count for why, count in counts.items() if count})

    def X_WL(self) -> RigidTransform:
        """Pose of the sender's frame in W, when the last volume was acquired."""
        assert self.newest is not None
        return self._maker.X_WL(self.newest)

    def hold_grey_levels(self, held: bool) -> None:
        """Keep the grey levels as they are while something is tracked."""
        self._maker.grey.held = held

    def take(self, timeout: float = 0.0) -> Volume | NotFound:
        """Return the next volume, waiting for it at most ``timeout`` s, or why there is none."""
        end = time.perf_counter() + timeout
        while True:
            posed = self._next(end)
            if posed is None:
                return NotFound(f"no volume has come from {self.address}")
            before = self._maker.grey.window
            try:
                volume = self._maker(posed)
            except Exception as error:  # whatever a foreign image sets off costs that image alone
                volume = NotFound(f"{posed.image.name}: {type(error).__name__}: {error}")
            window = self._maker.grey.window
            if window is not None and before not in (None, window):
                self._say(f"numbers from {window.low:g} to {window.high:g} are now black to white")
            if isinstance(volume, Volume):
                self.newest = posed
                self._proved.add(posed.sender)
                self._taken += 1
                return volume
            if volume.reason:
                self._no_volume += 1
                self._say(volume.reason)
                if posed.sender not in self._proved:
                    with self._news:
                        self._matcher.refuse(posed.sender)

    def _next(self, end: float) -> PosedImage | None:
        with self._news:
            while not self._images:
                if self.link.failure is not None:
                    raise self.link.failure
                left = end - time.perf_counter()
                self._keep_images(self._matcher.release(time.perf_counter()))
                if self._images:
                    break
                if left <= 0:
                    return None
                self._news.wait(min(left, 0.05))
            return self._images.popleft()

    def _receive(self, item: Item, arrived: float, peer: str) -> None:
        with self._news:
            self._keep_images(self._matcher.feed(item, arrived, peer))

    def _keep_images(self, images: list[PosedImage]) -> None:
        for image in images:
            self._images.append(image)
            self.times.append(image.time)
            keep = max(self._keep, _FIRST_KEPT) if self._taken < 2 else self._keep
            if too_many([each.image for each in self._images], keep):
                del self._images[
                    least(self._matcher.standing(each.sender[0]) for each in self._images)
                ]
                self.dropped += 1
        if images:
            self._news.notify_all()

    def _say(self, line: str) -> None:
        """Report a line once, not for each of the images that it is true of."""
        if line != self._said:
            self._said = line
            self.link.say(f"{self.link.address}: {line}")
