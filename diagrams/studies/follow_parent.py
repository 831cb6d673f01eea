"""Processes that end with their parent."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.resource_tracker import ensure_running

_WATCH_PERIOD = 0.2
"""Time in s between two looks of a process at its parent."""


@contextmanager
def keeping_ctrl_c() -> Iterator[None]:
    """Start processes inside that Ctrl-C never reaches, not even while they import.

    This process receives it after the block.
    """
    ensure_running()  # Python lets Ctrl-C through again when it starts its tracker of resources
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def follow_parent(parent: int) -> None:
    """Leave Ctrl-C to the parent process, and end with it however it ends.

    Every process of a terminal receives Ctrl-C, and the parent process handles it.

    Parameters
    ----------
    parent
        Number of the parent process.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=watch, daemon=True).start()
