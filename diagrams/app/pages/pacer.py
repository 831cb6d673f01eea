"""Pauses, steps, speed and end of a run, as its console asks for them."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from sonoservo.diagrams.app.pages.real_time import RealTime

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

_LOOK = 1 / 32  # Time in s between two looks at the console during a pause


class Pacer:
    """Holds a run back while its console asks for it; call `wait` after every volume.

    The speed is a multiple of real time, 0 for as fast as possible; with ``keeps_speed``, `wait`
    also holds the run to it, which a simulator does itself.
    """

    def __init__(
        self,
        console: "Console",
        *,
        speed: float = 1.0,
        keeps_speed: bool = False,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._console, self._sleep = console, sleep
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
            self._sleep(_LOOK)
        if held or controls.speed != self._speed:
            self._speed, held, self._origin = controls.speed, True, None
            self._real_time.start(now)
        if not self._paused:
            factor = self._real_time.factor
            pace = "" if factor is None else f"{factor:.1f} × real time"
            self._console.say(paused=False, pace=pace)
        if self._keeps_speed and self._speed > 0 and not self._paused:
            start, begun = self._origin = self._origin or (now, time.perf_counter())
            self._sleep(max(0.0, (now - start) / self._speed - (time.perf_counter() - begun)))
        return held
