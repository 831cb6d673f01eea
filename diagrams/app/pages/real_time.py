"""Comparison of a simulation's speed with real time."""

import time
from collections import deque
from collections.abc import Callable


class RealTime:
    """Measures a simulation's delay against real time, and its speed over a recent window, in s.

    The patience is the largest delay in s that the simulation may make up for: the computation of a
    volume, but no persistent lack of speed.
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
        """Restart at a simulated time in s, at the start or after a pause."""
        self._origin = (self._clock(), simulated)
        self._past = deque([self._origin])

    def is_late(self, simulated: float) -> bool:
        """Record the simulated time in s; return True if the delay is too large to make up for.

        The delay is then reset to zero.
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
        """Recent ratio of simulated to real time; None before a third of the window has passed."""
        (first, start), (last, end) = self._past[0], self._past[-1]
        if last - first < self._window / 3:
            return None
        return (end - start) / (last - first)
