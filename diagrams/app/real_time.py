"""Whether a simulation keeps up with real time."""

import time
from collections import deque
from collections.abc import Callable


class RealTime:
    """Watches how far a simulation is behind real time, and how fast it has been of late.

    Parameters
    ----------
    window
        Over which the speed is measured, in s of real time.
    patience
        Most delay that may be made up for, in s: a volume's computation is, a lasting lack is not.
    clock
        Real time, in s.
    """

    def __init__(
        self,
        *,
        window: float = 3.0,
        patience: float = 0.5,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._window, self._patience, self._clock = window, patience, clock
        self.start(0.0)

    def start(self, simulated: float) -> None:
        """Begin anew at a simulated time in s: at the start, after a pause."""
        self._origin = (self._clock(), simulated)
        self._past = deque([self._origin])

    def is_late(self, simulated: float) -> bool:
        """Note how far the simulation is, in s; whether it is further behind than is made up for.

        What is lost is then forgiven.
        """
        now = (self._clock(), simulated)
        self._past.append(now)
        while now[0] - self._past[1][0] > self._window:
            self._past.popleft()
        late = (now[0] - self._origin[0]) - (simulated - self._origin[1]) > self._patience
        if late:
            self._origin = now
        return late

    @property
    def factor(self) -> float | None:
        """Simulated by real time of late; None before a third of the window has passed."""
        (first, start), (last, end) = self._past[0], self._past[-1]
        if last - first < self._window / 3:
            return None
        return (end - start) / (last - first)
