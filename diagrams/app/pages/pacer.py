"""Pauses, steps, speed and end of a run, as its console asks for them, against real time."""

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from sonoservo.systems.evaluation.reports.report import speed_text

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_LOOK = 1 / 32  # Time in s between two looks at the console during a pause


class Pacer:
    """Holds a run back while its console asks for it; call `wait` after every volume.

    A program that goes on in strides of its own calls `look` before each instead, and obeys
    `paused` and `late`. The speed is a multiple of real time, 0 for as fast as possible, None
    without a choice; with ``keeps_speed``, `wait` also holds the run to it, which a simulator does
    itself. The console has a button that pauses, and others.

    `paused`: what the console wants; `late`: whether the delay is too large to make up for; `pace`
    in words.
    """

    def __init__(
        self,
        console: "Console",
        *buttons: str,
        speed: float | None = 1.0,
        keeps_speed: bool = False,
    ) -> None:
        self._console = console
        self._keeps_speed = keeps_speed
        self._real_time = RealTime()
        self._origin: tuple[float, float] | None = None
        self.paused = self.late = False
        self.pace = ""
        console.controls.offer_buttons("pause", *(buttons or ("step", "stop")), speed=speed)
        self.speed: float = console.controls.speed

    def look(self, now: float) -> set[str]:
        """Take note of a run's time in s, show the pace, and return the buttons pressed so far."""
        pressed = self._console.controls.pressed()
        self.paused ^= "pause" in pressed
        self.late = self._real_time.is_late(now)
        if self.paused:
            self._real_time.start(now)
        factor = self._real_time.factor
        self.pace = "" if factor is None else f"{speed_text(factor)} × real time"
        self._console.say(paused=self.paused, pace=self.pace)
        return pressed

    def wait(self, now: float) -> bool:
        """Wait while the run is paused, or ahead of its speed; ``now`` is its time in s.

        Returns True if time has been lost that is not to be made up for, or the speed has changed;
        KeyboardInterrupt is the console's wish to end, as Ctrl-C is.
        """
        held = False
        while True:
            pressed = self.look(now)
            if "stop" in pressed:
                raise KeyboardInterrupt
            if "step" in pressed:
                self.paused = True
                if held:
                    break
            if not self.paused:
                break
            held = True
            time.sleep(_LOOK)
        if held or self._console.controls.speed != self.speed:
            self.speed, held = self._console.controls.speed, True
            self._real_time.start(now)
        held |= self.late
        if held:
            self._origin = None
        if self._keeps_speed and self.speed > 0 and not self.paused:
            start, begun = self._origin = self._origin or (now, time.perf_counter())
            time.sleep(max(0.0, (now - start) / self.speed - (time.perf_counter() - begun)))
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
