"""Readings of the console: the state in words, and strips and pictures of the last minute."""

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.control.visual_features import needle_features
from sonoservo.systems.display.console.slices import SlicePicture, line_classes
from sonoservo.systems.signals.line_hypotheses import LineHypotheses
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.search_reason import LONGER, Reader, SearchReason, advice

Floats = NDArray[np.float64]

_NONE = math.nan
_WAITING = "waiting for the first volume (kernels are compiled once, up to a minute)"


@dataclass(frozen=True)
class Reading:
    """A labelled number of the page: name, label, value, unit and number of decimals."""

    name: str
    label: str
    value: float
    unit: str
    digits: int = 1

    def shown(self) -> list[str]:
        """Return name, label, number and unit as the page shows them; a dash for no number."""
        text = f"{self.value:z.{self.digits}f}".replace("-", "\u2212")
        return [self.name, self.label, text if math.isfinite(self.value) else "\u2013", self.unit]


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Values of the strips at one time in s; NaN where there is none.

    `mode` is the tracking mode, empty without a tracker. X, Z and depth of the estimated tip, the
    true inserted length and the distance `error` from the truth are in mm, theta in deg, force and
    target in N. The probability is the estimate's, or that of the most probable line; `lines`
    counts those that are followed, by class. `readings` replace those of a tracked needle.
    `reason`, `held` and `stopped` say why the tracker, the servo or the guard does not go on.
    """

    time: float
    mode: str = ""
    x: float = _NONE
    z: float = _NONE
    theta: float = _NONE
    depth: float = _NONE
    force: float = _NONE
    target: float = _NONE
    error: float = _NONE
    probability: float = _NONE
    inserted: float = _NONE
    lines: Mapping[str, int] = field(default_factory=dict)
    readings: Sequence["Reading"] = ()
    reason: str = ""
    held: str = ""
    stopped: str = ""


def sample_estimate(
    time: float,
    estimate: NeedleEstimate | None,
    X_WP: RigidTransform,
    lines: LineHypotheses | None = None,
    **values: Any,
) -> Sample:
    """Return a sample with the features of an estimate, seen from the probe."""
    if lines:
        followed = Counter(name for name in line_classes(lines) if name != "nothing")
        values |= {"lines": followed, "probability": float(lines.probabilities.max())}
    if estimate is None:
        return Sample(time=time, **values)
    seen = estimate.volume_time > -math.inf
    values |= {"mode": str(estimate.mode), "reason": estimate.reason if seen else _WAITING}
    if estimate.curve is None:
        return Sample(time=time, **values)
    values["probability"] = estimate.probability
    return Sample(
        time=time, **needle_place(estimate.curve.entry, estimate.curve.tip, X_WP), **values
    )


def needle_place(p_WEntry: Floats, p_WTip: Floats, X_WP: RigidTransform) -> dict[str, Any]:
    """Return features and depth of a needle, seen from the probe, in mm and deg."""
    entry, tip = X_WP.inverse().multiply(np.stack([p_WEntry, p_WTip]).T).T
    x, z, theta = needle_features(tip, tip - entry).tolist()
    return {
        "x": 1e3 * x, "z": 1e3 * z, "theta": math.degrees(theta), "depth": 1e3 * float(tip[1]),
    }  # fmt: skip


def tip_error(estimate: NeedleEstimate, tips: Sequence[tuple[float, Floats]]) -> float:
    """Return the distance in mm of an estimated tip from the true one; NaN if unknown."""
    if estimate.curve is None or not tips or estimate.time < tips[0][0]:
        return _NONE
    times, positions = zip(*tips, strict=True)
    true = [np.interp(estimate.time, times, axis) for axis in np.array(positions).T]
    return 1e3 * float(np.linalg.norm(estimate.curve.tip - true))


def shown_number(value: float) -> float | None:
    """Return a number for a page, which shows thousandths; None if it is not finite."""
    return round(value, 3) if math.isfinite(value) else None


def needle_readings(sample: Sample) -> list[Reading]:
    """Return the readings of a sample: its own, or those of a tracked needle."""
    if sample.readings:
        return list(sample.readings)
    return [
        Reading("x", "X", sample.x, "mm"),
        Reading("z", "Z", sample.z, "mm"),
        Reading("theta", "Theta", sample.theta, "deg"),
        Reading("depth", "tip depth", sample.depth, "mm"),
        Reading("force", "force", sample.force, "N", 2),
        Reading("error", "tip error", sample.error, "mm", 2),
        Reading("probability", "P(needle)", 100 * sample.probability, "%", 0),
        Reading("inserted", "inserted", sample.inserted, "mm"),
    ]


def describe_state(sample: Sample | None, *, operated: bool = False) -> dict[str, str]:
    """Return the state in words: ``kind``, ``word``, ``detail`` and ``advice``.

    Advice is for who can follow it: who opened a recording, or pushes an ``operated`` needle.
    """
    if sample is None:
        return {"kind": "waiting", "word": "waiting", "detail": _WAITING, "advice": ""}
    if sample.stopped:
        return {
            "kind": "stopped", "word": "stopped by the guard", "detail": sample.stopped,
            "advice": "",
        }  # fmt: skip
    if not sample.mode:
        word = sample.reason or "showing"
        return {"kind": "showing", "word": word, "detail": "", "advice": ""}
    kind, detail, said = sample.mode, sample.reason, ""
    if kind == "searching" and detail != _WAITING:
        reason = SearchReason.of(detail)
        if reason is not None:
            detail = reason.words
            recorded = math.isnan(sample.inserted)
            if recorded or (operated and sample.inserted > 0):  # else there is nothing to be found
                # A run that goes on gets longer by itself.
                remedies = [each for each in reason.remedies if each is not LONGER]
                said = advice(remedies, Reader.RECORDING if recorded else Reader.OPERATOR)
    return {"kind": kind, "word": kind, "detail": detail, "advice": said}


MINUTE = 60.0
"""Time in s for which strips and pictures are kept."""

STRIPS = ("time", "x", "z", "theta", "force", "target", "error", "probability", "mode")
"""Columns of the strips."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Pictures of one volume, with its number, time in s and tracking mode (or nothing)."""

    number: int
    time: float
    mode: str
    pictures: Sequence[SlicePicture | None]
    decibels_per_level: float
    paths: Mapping[str, Sequence[Any]] = field(default_factory=dict)


class Strips:
    """Samples of the last minute, numbered so that pages can catch up."""

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
