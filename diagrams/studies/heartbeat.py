"""Sign of life of a long command whose output is not a terminal, which shows no bar."""

import threading
import time
from types import TracebackType
from typing import Self

from rich.console import Console


class Heartbeat:
    """Prints how long something has taken, again and again, unless the console is a terminal.

    Parameters
    ----------
    console
        Console to print on.
    what
        What is being done.
    period
        Time between two lines, in s.
    """

    def __init__(self, console: Console, what: str, period: float = 5.0) -> None:
        self._console, self._what, self._period = console, what, period
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Self:
        self._console.print(f"{self._what} ...")
        if not self._console.is_terminal:
            self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _beat(self) -> None:
        began = time.monotonic()
        while not self._over.wait(self._period):
            self._console.print(f"{self._what} ... {time.monotonic() - began:.0f} s")
