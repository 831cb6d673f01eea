"""The worker's side of a cluster: cases in processes of their own.

Dask's worker only waits for them, so a case that crashes, hangs or fills the memory never takes the
worker along, and can be ended at any time.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from typing import Any, Literal

from sonoservo.diagrams.studies.cluster import case_process
from sonoservo.diagrams.studies.processes import THREADS
from sonoservo.diagrams.studies.study import CASES_PER_PROCESS, DIED

_START_S = 120.0
"""Longest time in s that a process may need to start."""

_LOOK_S = 0.2
"""Time in s between two looks whether a case is still wanted."""


@dataclass(frozen=True)
class Reply:
    """Answer of a worker to a case.

    Parameters
    ----------
    kind
        "finished"; "lost" if the case's process ended or took too long; "refused" if the worker
        cannot run such cases.
    content
        `Finished` case, reason of a loss, or identity or reason of a refusal.
    """

    kind: Literal["finished", "lost", "refused"]
    content: Any


def _search_path() -> str:
    """Return where this process finds modules, such as those next to the program's script."""
    return os.pathsep.join(filter(None, sys.path))


class _CaseProcess:
    """Process that runs cases one after the other, with one thread."""

    def __init__(self) -> None:
        ours, theirs = Pipe()
        with theirs:
            command = [sys.executable, "-m", case_process.__name__]
            self._process = subprocess.Popen(
                [*command, str(theirs.fileno()), str(os.getpid())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is not for cases
                env={**os.environ, **dict.fromkeys(THREADS, "1"), "PYTHONPATH": _search_path()},
            )
        self.connection = ours
        self.cases, self.rested = 0, 0.0
        try:
            if not ours.poll(_START_S):
                raise EOFError
            self.identity: Mapping[str, str] = ours.recv()
        except (EOFError, OSError):
            self.end()
            raise

    def end(self) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.wait()
        self.connection.close()


_resting: list[_CaseProcess] = []
_lock = threading.Lock()


def _take() -> _CaseProcess:
    """Return a process that is ready for a case."""
    while True:
        with _lock:
            if not _resting:
                break
            process = _resting.pop()
        # A process that rests for long ends itself.
        if time.monotonic() - process.rested < case_process.IDLE_S / 2:
            return process
        process.end()
    return _CaseProcess()


def _give_back(process: _CaseProcess) -> None:
    if process.cases >= CASES_PER_PROCESS:
        process.end()
        return
    process.rested = time.monotonic()
    with _lock:
        _resting.append(process)


def run_case(message: bytes, identity: Mapping[str, str], limit: float) -> Reply:
    """Run a case as a task of a Dask worker.

    Parameters
    ----------
    message
        Pickled function, store and case.
    identity
        `package_identity` of the process that asks; the worker's must be the same.
    limit
        Longest time in s that the case may take.
    """
    try:
        process = _take()
    except (EOFError, OSError) as error:
        return Reply("refused", f"no process starts: {error or 'it ends at once'}")
    if process.identity != identity:
        _give_back(process)
        return Reply("refused", process.identity)
    try:
        reply = _wait(process, message, limit, _is_wanted())
    except BaseException:
        process.end()
        raise
    if reply.kind == "lost":
        process.end()
    else:
        process.cases += 1
        _give_back(process)
    return reply


def _wait(process: _CaseProcess, message: bytes, limit: float, wanted: Callable[[], bool]) -> Reply:
    deadline = time.monotonic() + limit
    try:
        process.connection.send_bytes(message)
        while not process.connection.poll(_LOOK_S):
            if time.monotonic() > deadline:
                return Reply("lost", f"no result within {limit:g} s")
            if not wanted():
                return Reply("lost", "it is not wanted any more")
        kind, content = process.connection.recv()
    except (EOFError, OSError):
        return Reply("lost", DIED)
    return Reply("refused" if kind == "unloadable" else kind, content)


def _is_wanted() -> Callable[[], bool]:
    """Return a function that tells whether the present task of the worker is still wanted.

    It is not if it was cancelled, or if the client or the scheduler is gone.
    """
    from distributed import get_worker
    from distributed.core import Status

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        running = worker.status in (Status.running, Status.paused, Status.closing_gracefully)
        return running and task is not None and task.state == "executing"

    return wanted


def end_resting_processes() -> None:
    """End the processes that wait for a case."""
    with _lock:
        processes, _resting[:] = _resting[:], []
    for process in processes:
        with suppress(OSError):
            process.end()
