"""What the console has shown so far: strips and pictures of the last minute."""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sonoservo.systems.display.console.readings import Sample
from sonoservo.systems.display.console.slices import SlicePicture

MINUTE = 60.0
"""Time in s for which strips and pictures are kept."""

STRIPS = ("time", "x", "z", "theta", "force", "target", "error", "probability", "mode")
"""Columns of the strips."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Pictures of one volume, with its number, time in s and tracking mode (or nothing).

    A slice that misses the volume is None. `paths` are the columns of the charts of `ShapePage`, in
    mm.
    """

    number: int
    time: float
    mode: str
    pictures: Sequence[SlicePicture | None]
    decibels_per_level: float
    paths: Mapping[str, Sequence[Any]] = field(default_factory=dict)


class Strips:
    """Samples of the last minute, numbered so that pages can catch up.

    `end` is the number of the next one.
    """

    def __init__(self) -> None:
        self._samples: deque[Sample] = deque()
        self.end = 0

    def append(self, sample: Sample) -> None:
        """Add a sample; one that is earlier than the last one starts the strips anew."""
        if self._samples and sample.time < self._samples[-1].time:
            self._samples.clear()
            self.end += 1  # a gap, from which pages see that the old ones are gone
        self._samples.append(sample)
        self.end += 1
        while self._samples[0].time < sample.time - MINUTE:
            self._samples.popleft()

    @property
    def newest(self) -> Sample | None:
        """Last sample, if any."""
        return self._samples[-1] if self._samples else None

    @property
    def begin(self) -> int:
        """Number of the oldest sample that is kept."""
        return self.end - len(self._samples)

    def columns(self, begin: int = 0) -> dict[str, list[float | str]]:
        """Return the values from a sample on, by column."""
        samples = list(self._samples)[max(begin - self.begin, 0) :]
        return {name: [getattr(each, name) for each in samples] for name in STRIPS}


class Cine:
    """Frames of the last minute, in order of time."""

    def __init__(self) -> None:
        self._frames: deque[Frame] = deque()

    def append(self, frame: Frame) -> None:
        """Add a frame; one that is earlier than the last one starts the cine anew."""
        if self._frames and frame.time < self._frames[-1].time:
            self._frames.clear()
        self._frames.append(frame)
        while self._frames[0].time < frame.time - MINUTE:
            self._frames.popleft()

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def times(self) -> list[float]:
        """Times of the frames, in s."""
        return [frame.time for frame in self._frames]

    def at(self, time: float) -> Frame | None:
        """Return the frame nearest to a time in s; None if there is none."""
        return min(self._frames, key=lambda frame: abs(frame.time - time), default=None)
