"""Clock that stands still while kernels are compiled."""

import time
from collections.abc import Callable
from typing import Self

from numba.core.event import Event, Listener, register, unregister

COMPILATION = "numba:compile"
"""Numba's name of the compilation of a kernel; loading a compiled one from its file is none."""

FIRST_USE = "numba:compiler_lock"
"""Numba's name of what it does at the first use of a kernel in a process: to compile or load it."""


class CompileFreeClock(Listener):
    """Clock in s that stands still while Numba compiles kernels, which happens once a machine.

    With `FIRST_USE` as its event, it also stands still while compiled ones are loaded.
    """

    def __init__(
        self, clock: Callable[[], float] = time.perf_counter, event: str = COMPILATION
    ) -> None:
        self._clock, self._event = clock, event
        self.compiled = 0.0
        self._begun = 0.0
        self._depth = 0  # a kernel's compilation may start that of another one

    def __call__(self) -> float:
        """Return the time without compilation, in s."""
        return self._clock() - self.compiled

    def __enter__(self) -> Self:
        register(self._event, self)
        return self

    def __exit__(self, *error: object) -> None:
        unregister(self._event, self)

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
