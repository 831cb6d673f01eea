"""Pauses, steps, speed and end of a run, as its console asks for them, against real time."""

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_LOOK = 1 / 32  # Time in s between two looks at the console during a pause


class Pacer:
    """Holds a run back while its console asks for it; call `wait` after every volume.

    The speed is a multiple of real time, 0 for as fast as possible; with ``keeps_speed``, `wait`
    also holds the run to it, which a simulator does itself.
    """

    def __init__(
        self, console: "Console", *, speed: float = 1.0, keeps_speed: bool = False
    ) -> None:
        self._console = console
        self._keeps_speed = keeps_speed
        self._real_time = RealTime()
        self._origin: tuple[float, float] | None = None
        self._paused = False
        self._speed = speed
        console.controls.offer_buttons("pause", "step", "stop", speed=speed)

    @property
    def speed(self) -> float:
        """Speed that the console asks for."""
        return self._speed

    def wait(self, now: float) -> bool:
        """Wait while the run is paused, or ahead of its speed; ``now`` is its time in s.

        Returns True if time has been lost on purpose, or the speed has changed; KeyboardInterrupt
        is the console's wish to end, as Ctrl-C is.
        """
        controls, held = self._console.controls, False
        self._real_time.is_late(now)
        while True:
            pressed = controls.pressed()
            if "stop" in pressed:
                raise KeyboardInterrupt
            if "pause" in pressed:
                self._paused = not self._paused
            if "step" in pressed:
                self._paused = True
                if held:
                    break
            if not self._paused:
                break
            held = True
            self._console.say(paused=True, pace="")
            time.sleep(_LOOK)
        if held or controls.speed != self._speed:
            self._speed, held, self._origin = controls.speed, True, None
            self._real_time.start(now)
        if not self._paused:
            factor = self._real_time.factor
            pace = "" if factor is None else f"{factor:.1f} × real time"
            self._console.say(paused=False, pace=pace)
        if self._keeps_speed and self._speed > 0 and not self._paused:
            start, begun = self._origin = self._origin or (now, time.perf_counter())
            time.sleep(max(0.0, (now - start) / self._speed - (time.perf_counter() - begun)))
        return held


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
