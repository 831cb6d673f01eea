"""Matching of images and poses as their messages arrive."""

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live import acquisition
from sonoservo.systems.live.acquisition import read_acquisition_item
from sonoservo.systems.live.connection.items import ImageItem, Item, PoseItem, TextItem
from sonoservo.systems.live.pose_history import PoseHistory
from sonoservo.systems.live.stream_clock import StreamClock
from sonoservo.systems.recording.side_files import Acquisition
from sonoservo.systems.recording.transform_chain import TransformChain, find_chain
from sonoservo.systems.signals.immutable import Immutable, NotFound

DEFAULT_POSES = "ProbeToReference"

_SAME = 1e-6  # Time stamps in s that differ by less are the same
# Time in s that an image waits for its pose; the first one, to see whether there are poses.
_WAIT, _FIRST_WAIT = 0.15, 0.5
# A time stamp in s that jumps further is that of a clock that was set anew.
_BACKWARDS, _FORWARDS = 1.0, 60.0
_APART = 0.5  # Difference in s between two clocks that delays of messages do not explain
# Time in s after which another peer may take the place of one that sends nothing more.
_SILENT = 2.0
_ESTABLISHED = 10  # Number of images in a row after which the images of other peers are left aside
_REMEMBERED, _WAITING, _NAMES, _SENDERS = 8, 32, 32, 512
_MAX_WAITING = 1 << 29  # Bytes of the images that wait at most; at least one may wait


class LeftOut(Enum):
    """Why something that came in was left out, in words for a person."""

    DAMAGED = "damaged, or without sense"
    NO_POSE = "no pose near its time"
    STAMP = "time stamp missing, or not later than the last one's"
    TOO_MANY = "too many waited for their poses"
    NO_VOLUME = "no volume could be made of it"


@dataclass(frozen=True, eq=False)
class PosedImage(Immutable):
    """An image and the pose X_WL that the sender's frame L had: identity for a probe at rest.

    `acquisition`: what a scanner of this package said of it; `time` in s, which unlike the image's
    own stamp never runs backwards; `arrived`: arrival of its last byte (`time.perf_counter`);
    `sender`: peer and device.
    """

    image: ImageItem
    X_WL: RigidTransform
    acquisition: Acquisition | None
    time: float
    arrived: float
    sender: tuple[str, str] = ("", "")


def too_many(images: Sequence[ImageItem], most: int) -> bool:
    """Return whether more images wait than may: in number, or in bytes if there are several."""
    size = sum(image.voxels.nbytes for image in images)
    return len(images) > most or (len(images) > 1 and size > _MAX_WAITING)


def least(numbers: Iterable[int]) -> int:
    """Return the place of the smallest number, of the first one if there are several."""
    every = list(numbers)
    return every.index(min(every))


@dataclass(eq=False)
class _Sender:
    """What one peer has sent of late; times in s.

    `device`: that of its images, empty before the first; `offset`: time stamps of the poses minus
    those of its images; `links`, `uncomposed`: other transforms by name, and times at which a chain
    of them is not known yet; `images`: their number since its clock jumped; `shift`: time of the
    stream minus its stamps; `stamp`, `arrived`: those of its last image.
    """

    device: str
    offset: float
    heard: float = 0.0
    images: int = 0
    image_clock: StreamClock = field(default_factory=StreamClock)
    pose_clock: StreamClock = field(default_factory=StreamClock)
    poses: PoseHistory = field(default_factory=PoseHistory)
    poses_by_arrival: PoseHistory = field(default_factory=PoseHistory)
    links: dict[str, PoseHistory] = field(default_factory=dict)
    uncomposed: list[float] = field(default_factory=list)
    said: OrderedDict[float, Acquisition] = field(default_factory=OrderedDict)
    stamp: float | None = None
    shift: float = 0.0
    arrived: float = 0.0
    arrival_told: bool = False


class ImageMatcher:
    """Puts images and poses together that have the same time stamp, or nearly.

    An image waits until a pose at its time or later is there, so that it can be interpolated, but
    not for long. If poses are neither asked for nor there when the first image comes, the probe is
    taken to be at rest until the first pose.

    Several peers may send to one port. An image takes its pose from its own peer, or from another
    if that one sends none. A peer that has sent ten images in a row is the scanner: those of
    others are left aside until it has been silent for 2 s.

    Where time stamps stand still or are not in s, the times of arrival take their place. Where the
    clocks of images and poses are further apart than messages can be delayed, the difference is
    estimated from the times of arrival, and told.

    Parameters
    ----------
    device
        Device whose images are taken; empty for the one whose image arrives first.
    poses
        Device whose transforms are the pose of L, or a chain of transforms (`find_chain`); "none"
        for a probe at rest. By default ``ProbeToReference``, if there is such a device, or the
        chain that leads from Probe to a frame that stands still.
    layers
        True to take volumes, False to take 2D frames.
    clock_offset
        Time stamps of poses minus those of images taken at the same time, in s; by default 0, or
        what the times of arrival tell.
    report
        Function that is called with one line for a person.
    """

    def __init__(
        self,
        *,
        device: str = "",
        poses: str | None = None,
        layers: bool = True,
        clock_offset: float | None = None,
        report: Callable[[str], None] = print,
    ) -> None:
        self._wanted, self._layers, self._report = device, layers, report
        self._pose_name = poses or DEFAULT_POSES
        self._posed = {None: None, "none": False}.get(poses, True)
        self._told = False
        self._clock_offset = clock_offset
        self._senders: dict[str, _Sender] = {}
        self._scanner = ""
        self._waiting: list[tuple[ImageItem, str, float]] = []
        self._others: set[str] = set()
        self._asked = poses
        self._chain: TransformChain | None = None
        self._last: float | None = None
        self._step = 0.1
        self.left_out: Counter[LeftOut] = Counter()

    @property
    def posed(self) -> bool:
        """True if images have poses, of a device or with what tells how they were acquired."""
        return bool(self._posed) or self._told

    @property
    def clock_offset(self) -> float:
        """Time stamps of poses minus those of images, in s, as stated or last estimated."""
        offsets = [sender.offset for sender in self._senders.values() if sender.offset]
        return offsets[-1] if offsets else 0.0

    @property
    def chain(self) -> TransformChain | None:
        """Transforms that give the pose together; None if one device does, or none."""
        return self._chain

    @property
    def counts_arrivals(self) -> bool:
        """True if time stamps of images stand still."""
        return any(sender.image_clock.stands for sender in self._senders.values())

    def feed(self, item: Item, now: float, peer: str = "") -> list[PosedImage]:
        """Take in an item that arrived ``now`` from a peer; return the images it completes."""
        sender = self._sender(peer, now)
        if isinstance(item, PoseItem):
            self._note_pose(item, sender, now)
        elif isinstance(item, TextItem) and item.name == acquisition.NAME:
            said = read_acquisition_item(item)
            sender.said[said.times[0]] = said
            if len(sender.said) > _REMEMBERED:
                sender.said.popitem(last=False)
        elif isinstance(item, ImageItem) and self._is_wanted(item, sender, peer, now):
            sender.image_clock.note(item.time, now)
            self._waiting.append((item, peer, now))
            while too_many([image for image, _, _ in self._waiting], _WAITING):
                del self._waiting[least(self.standing(each) for _, each, _ in self._waiting)]
                self.left_out[LeftOut.TOO_MANY] += 1
        return self.release(now)

    def standing(self, peer: str) -> int:
        """Number of images in a row that a peer has sent; who has sent few makes way for others."""
        return self._senders[peer].images if peer in self._senders else 0

    def refuse(self, sender: tuple[str, str]) -> None:
        """Let another device of a peer take the place of one whose images make no volumes."""
        peer, device = sender
        if peer in self._senders and self._senders[peer].device == device:
            self._senders[peer].device = self._wanted

    def release(self, now: float) -> list[PosedImage]:
        """Return the images that need not, or may not, wait any longer."""
        ready: list[PosedImage] = []
        while self._waiting and (image := self._complete(*self._waiting[0], now)) is not None:
            self._waiting.pop(0)
            if isinstance(image, PosedImage):
                ready.append(image)
            else:
                why, reason = image
                self.left_out[why] += 1
                self._report(f"an image is left out: {reason}")
        return ready

    def _sender(self, peer: str, now: float) -> _Sender:
        sender = self._senders.pop(peer, None) or _Sender(self._wanted, self._clock_offset or 0.0)
        sender.heard = now
        self._senders[peer] = sender  # the one that was heard last is the last
        if len(self._senders) > _SENDERS:  # the least useful one of those heard longest ago
            del self._senders[min(self._senders, key=lambda each: self._senders[each].images)]
        return sender

    def _note_pose(self, item: PoseItem, sender: _Sender, now: float) -> None:
        if item.name == self._pose_name:
            sender.pose_clock.note(item.time, now)
            sender.poses.add(item.time, item.X)
            sender.poses_by_arrival.add(now, item.X)
        elif len(self._others) < _NAMES or item.name in self._others:
            self._others.add(item.name)
            sender.links.setdefault(item.name, PoseHistory()).add(item.time, item.X)
            if self._chain is not None and item.name == self._chain.links[0].name:
                sender.uncomposed = [*sender.uncomposed[1 - _WAITING :], item.time]
                sender.pose_clock.note(item.time, now)
            self._compose(sender, now)

    def _find_chain(self, now: float) -> bool:
        """Look for transforms that give the probe's pose together; return whether there are."""
        try:
            chain = find_chain(Path("stream"), self._others, self._asked, starts=("Probe",))
        except ConfigurationError:
            return False
        if chain is None or self._chain is not None:
            return False
        self._chain = chain
        self._report(f"poses: {chain}")
        for sender in self._senders.values():
            if chain.links[0].name in sender.links:
                sender.uncomposed = list(sender.links[chain.links[0].name].times)
                sender.pose_clock.note(sender.uncomposed[-1], now)
                self._compose(sender, now)
        return True

    def _compose(self, sender: _Sender, now: float) -> None:
        """Make poses of the transforms in the chain, at the times that all of them have reached."""
        if self._chain is None or not {link.name for link in self._chain.links} <= set(
            sender.links
        ):
            return
        histories = {link.name: sender.links[link.name] for link in self._chain.links}
        waiting = []
        for time in sender.uncomposed:
            if not all(history.reaches(time) for history in histories.values()):
                waiting.append(time)
                continue
            found = {name: history.at(time) for name, history in histories.items()}
            known = {n: X.GetAsMatrix4() for n, X in found.items() if isinstance(X, RigidTransform)}
            if len(known) == len(found):
                X = RigidTransform(self._chain.matrix(known))
                sender.poses.add(time, X)
                sender.poses_by_arrival.add(now, X)
        sender.uncomposed = waiting

    def _is_wanted(self, image: ImageItem, sender: _Sender, peer: str, now: float) -> bool:
        if (min(image.voxels.shape) > 1) != self._layers:
            if self._wanted == image.name:
                size = " x ".join(map(str, image.voxels.shape))
                self._report(
                    f"{image.name}: {size} numbers are no volume; --reconstruct makes volumes of "
                    "2D frames"
                    if self._layers
                    else f"{image.name}: {size} numbers are no 2D frame"
                )
            return False
        if sender.device not in ("", image.name):
            return False
        scanner = self._senders.get(self._scanner)
        if scanner and scanner is not sender and now - scanner.heard < _SILENT:
            return False
        sender.device = image.name
        return True

    def _complete(
        self, image: ImageItem, peer: str, arrived: float, now: float
    ) -> PosedImage | tuple[LeftOut, str] | None:
        """Return the image with its pose, why it is left out, or None if it should wait."""
        sender = self._senders.get(peer) or self._sender(peer, now)
        X_WL: RigidTransform | NotFound
        stamp = image.time
        said = next((v for v in sender.said.values() if abs(v.times[0] - stamp) < _SAME), None)
        if said is not None:
            stamp, X_WL, self._told = said.times[0], said.poses[0], True
        elif self._asked == "none":
            X_WL = RigidTransform()
        elif (
            (tracker := self._tracker(sender)) is None
            and self._posed is not False
            and now - arrived < _FIRST_WAIT
        ):
            return None
        elif tracker is None and self._find_chain(now):
            return self._complete(image, peer, arrived, now)
        elif tracker is None and not self._posed:
            if self._posed is None:
                there = f" (there are: {', '.join(sorted(self._others))})" if self._others else ""
                self._report(
                    f"there is no device {self._pose_name!r}{there}: the probe counts as at rest"
                )
            self._posed = False
            X_WL = RigidTransform()
        else:
            if self._posed is False:
                self._report("poses have come: the probe no longer counts as at rest")
            self._posed = True
            found = self._pose(stamp, arrived, sender, tracker, now - arrived < _WAIT)
            if found is None:
                return None
            X_WL = found
        if isinstance(X_WL, NotFound):
            return LeftOut.NO_POSE, X_WL.reason
        time = self._time(stamp, arrived, sender)
        if time is None:
            reason = f"its time stamp {stamp:.6f} s is not later than the last one's"
            return LeftOut.STAMP, reason
        if sender.images >= _ESTABLISHED:
            self._scanner = peer
        return PosedImage(image, X_WL, said, time, arrived, (peer, image.name))

    def _tracker(self, sender: _Sender) -> _Sender | None:
        """Return who tells the poses of a peer's images: itself, or who did so last."""
        if len(sender.poses):
            return sender
        return next((s for s in reversed(self._senders.values()) if len(s.poses)), None)

    def _pose(
        self, stamp: float, arrived: float, sender: _Sender, tracker: _Sender | None, wait: bool
    ) -> RigidTransform | NotFound | None:
        """Return the pose at an image's time, by the clocks or by the times of arrival."""
        if tracker is None:
            return None if wait else NotFound("there is no pose yet")
        if (
            sender.image_clock.stands
            or tracker.pose_clock.stands
            or 0 in (stamp, tracker.pose_clock.last)
        ):
            poses, at = tracker.poses_by_arrival, arrived
        else:
            poses, at = tracker.poses, stamp + sender.offset
        if wait and not poses.reaches(at):
            return None
        found = poses.at(at)
        if found or poses is not tracker.poses or self._clock_offset is not None:
            return found
        if sender.stamp is not None and not sender.image_clock.steady:
            return found  # one odd stamp is no clock that was set anew
        offset = sender.image_clock.delay - tracker.pose_clock.delay
        if abs(offset - sender.offset) < _APART:
            return found
        sender.offset = offset
        self._report(
            f"the clock of {self._pose_name} is {abs(offset):.2f} s "
            f"{'ahead of' if offset > 0 else 'behind'} that of {sender.device}, by the times of "
            "arrival; --clock-offset states it exactly"
        )
        return poses.at(stamp + offset)

    def _time(self, stamp: float, arrived: float, sender: _Sender) -> float | None:
        """Return the time of an image, which never runs backwards; None if its stamp is odd."""
        stands = sender.image_clock.stands
        if stands != sender.arrival_told:
            sender.arrival_told = stands
            self._report(
                "the time stamps stand still or are not in s; the times of arrival are taken"
                if stands
                else "the time stamps advance, and are taken from now on"
            )
            sender.stamp, sender.shift = None, 0.0
            self._step = max(arrived - sender.arrived, 1e-3)
        if stands:
            stamp = arrived
        elif stamp == 0 and sender.stamp:
            return None
        own = None if sender.stamp is None else stamp - sender.stamp
        jumped = own is not None and not -_BACKWARDS < own < _FORWARDS
        if jumped:
            self._report(f"the sender's clock jumped by {own:+.3f} s; the stream goes on")
        elif own is not None and own < _SAME:
            return None
        time = stamp + sender.shift
        if self._last is not None and (jumped or not 0 < time - self._last < _FORWARDS):
            time = self._last + self._step
            sender.shift = time - stamp
        elif own is not None:
            self._step = float(np.clip(own, 1e-3, 1.0))
        sender.images = 0 if jumped else sender.images + 1
        sender.stamp, sender.arrived, self._last = stamp, arrived, time
        return time
