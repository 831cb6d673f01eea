"""Connection from the scanner to the program: what is lost, comes late, or has to wait."""

from dataclasses import dataclass
from typing import Annotated, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, seal
from sonoservo.systems.signals.requirements import Bound, Bounded, NotNegative

T = TypeVar("T")

Share: TypeAlias = Annotated[
    float, Bound("a share of at least 0 and below 1", lambda share: 0 <= share < 1)
]

_SLACK = 1e-9


@dataclass(kw_only=True)
class ConnectionParameters(Bounded):
    """Losses and delays between the scanner and the program that takes its sweeps.

    Parameters
    ----------
    lost_frames
        Share of the frames that are lost; each shows the frame before it once more.
    lost_sweeps
        Share of the sweeps that are lost.
    lateness
        Mean time by which a sweep comes late, in s; exponentially distributed.
    """

    lost_frames: Share = 0.0
    lost_sweeps: Share = 0.0
    lateness: NotNegative = 0.0

    def is_lost(self, rng: np.random.Generator) -> bool:
        """Return True if a sweep is lost."""
        return bool(rng.random() < self.lost_sweeps)

    def late(self, rng: np.random.Generator) -> float:
        """Return the time by which a sweep comes late, in s."""
        return float(self.lateness * rng.standard_exponential())


def repeat_lost_frames(
    samples: NDArray[np.uint8], share: float, direction: int, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return the (frames, lines, samples) samples of a sweep of which frames were lost.

    In place of a lost frame stands the last one acquired before it, which the frame grabber still
    holds. The first frame of a sweep is never lost.
    """
    lost = rng.random(len(samples)) < share
    order = np.arange(len(samples))
    shown = np.maximum.accumulate(np.where(lost, 0, order))
    if direction < 0:
        shown = len(samples) - 1 - shown[::-1]
    return seal(samples[shown])


@dataclass(frozen=True, eq=False)
class Reception(Immutable, Generic[T]):
    """Sweeps on their way through a program that processes one at a time.

    When the program is done with a sweep, it takes the newest that has arrived, and drops those
    that were acquired before it: a program with a single thread that always wants the newest
    picture does so, as `sonoservo track` does on a live connection.

    Parameters
    ----------
    coming
        Time of arrival in s and sweep, in the order of acquisition, for those not taken yet.
    busy
        Time in s at which the program is done with its present sweep, and that sweep.
    processed
        The last sweep that was processed.
    """

    coming: tuple[tuple[float, T], ...] = ()
    busy: tuple[float, T] | None = None
    processed: T | None = None

    def sent(self, sweep: T, arrival: float) -> "Reception[T]":
        """Return the reception after a further sweep was sent, which arrives at a time in s."""
        return Reception((*self.coming, (arrival, sweep)), self.busy, self.processed)

    def at(self, time: float, processing_time: float) -> "Reception[T]":
        """Return the reception at a later time; a sweep takes a processing time; both in s."""
        coming, busy, processed = self.coming, self.busy, self.processed
        if busy is not None and busy[0] <= time + _SLACK:
            processed, busy = busy[1], None
        arrived = [n for n, (arrival, _) in enumerate(coming) if arrival <= time + _SLACK]
        if busy is None and arrived:
            newest = coming[arrived[-1]][1]
            coming = coming[arrived[-1] + 1 :]
            if processing_time > 0:
                busy = (time + processing_time, newest)
            else:
                processed = newest
        return Reception(coming, busy, processed)
