"""Clock that stands still while kernels are compiled."""

import time
from collections.abc import Callable
from typing import Self

from numba.core.event import Event, Listener, register, unregister

COMPILATION = "numba:compile"
"""Numba's name of the compilation of a kernel; loading a compiled one from its file is none."""


class CompileFreeClock(Listener):
    """Clock in s that stands still while Numba compiles kernels, which happens once a machine."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self.compiled = 0.0
        self._begun = 0.0
        self._depth = 0  # a kernel's compilation may start that of another one

    def __call__(self) -> float:
        """Return the time without compilation, in s."""
        return self._clock() - self.compiled

    def __enter__(self) -> Self:
        register(COMPILATION, self)
        return self

    def __exit__(self, *error: object) -> None:
        unregister(COMPILATION, self)

    def on_start(self, event: Event) -> None:
        """Note the start of a compilation."""
        if self._depth == 0:
            self._begun = self._clock()
        self._depth += 1

    def on_end(self, event: Event) -> None:
        """Note the end of a compilation."""
        self._depth -= 1
        if self._depth == 0:
            self.compiled += self._clock() - self._begun
