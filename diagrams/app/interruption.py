"""Ends of the program that are asked for from outside: Ctrl-C, SIGTERM and SIGHUP."""

import os
import signal
import socket
import sys
import threading
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

PATIENCE = 9.0
"""Time in s from an interruption to the end of the program, whatever it is doing: enough for a
report on a busy machine, and less than the 10 s after which containers are killed."""

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_RETRY = 0.01  # Time in s until an interruption that was swallowed is raised again
# Modules of the compiler, which an exception amidst them leaves in disorder.
_COMPILER = os.path.join("llvmlite", "binding", "")
_received: list[int] = []


def is_interrupted() -> bool:
    """Return True if a signal has asked for the end of the program."""
    return bool(_received)


def interrupted_code() -> int:
    """Return the exit code after an interruption: 128 plus the number of the first signal."""
    return 128 + (_received[0] if _received else signal.SIGINT)


def catch_interruptions() -> None:
    """Let SIGTERM and SIGHUP interrupt the program as Ctrl-C does, and end it within `PATIENCE`.

    All three raise KeyboardInterrupt in the main thread, so that a run keeps what it has. A second
    signal ends the program at once; one that is ignored at the start, as by ``nohup``, stays
    ignored. A thread keeps the watch, because the main thread may be inside a compiler. Callbacks
    from C and finalizers swallow exceptions, so an interruption in one is raised again; one amidst
    the compiler, which holds its locks and may crash, waits.
    """
    watch, wake = socket.socketpair()
    wake.setblocking(False)
    signal.set_wakeup_fd(wake.fileno(), warn_on_full_buffer=False)
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt_again)
    sys.unraisablehook = _retry_if_swallowed
    threading.Thread(target=_end_in_time, args=(watch, wake), daemon=True).start()


def _interrupt(number: int, frame: FrameType | None) -> None:
    if not _received:
        _received.append(number)
        _interrupt_again(number, frame)


def _interrupt_again(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, or wait if the compiler is at work."""
    while frame is not None:
        if _COMPILER in frame.f_code.co_filename:
            signal.setitimer(signal.ITIMER_REAL, _RETRY)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _retry_if_swallowed(swallowed: "UnraisableHookArgs") -> None:
    """Hook for an exception that a callback from C or a finalizer has swallowed."""
    if isinstance(swallowed.exc_value, KeyboardInterrupt) and _received:
        signal.setitimer(signal.ITIMER_REAL, _RETRY)
    else:
        sys.__unraisablehook__(swallowed)


def _end_in_time(watch: socket.socket, wake: socket.socket) -> None:
    """End the program some time after the first signal, or with the second."""
    while (first := watch.recv(1)) and first[0] not in _SIGNALS:
        pass
    watch.settimeout(PATIENCE)
    try:
        while (second := watch.recv(1)) and second[0] not in _SIGNALS:
            pass
    except TimeoutError:
        os.write(
            2, b"\nsonoservo: ended by the interruption; what was not written by now is left out\n"
        )
    wake.close()
    os._exit(128 + first[0])
