"""Executor of a study on the cores of this machine, in processes that end with their parent."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from multiprocessing.resource_tracker import ensure_running
from types import ModuleType

from sonoservo.diagrams.studies.store import Store
from sonoservo.diagrams.studies.study import (
    CASES_PER_PROCESS,
    DIED,
    Case,
    Finished,
    Outcome,
    Work,
    perform,
)
from sonoservo.systems.sampling.libraries import LINEAR_ALGEBRA

THREADS = (*LINEAR_ALGEBRA, "OMP_NUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Variables that limit the threads of a case to one."""

_WATCH_PERIOD = 0.2  # time in s between two looks of a process at its parent


class FinishedOnly:
    """Executor that runs nothing, so that a study consists of the runs that are finished."""

    slots = 0

    def run(
        self, work: Work, cases: Sequence[Case], store: Store, notify: Callable[[str], None]
    ) -> Generator[Finished]:
        """Yield nothing; see `Executor`."""
        yield from ()


class Processes:
    """Executor on the cores of this machine: a process of one thread for each slot.

    A process is replaced after some cases, because Drake's Python systems are never freed, and when
    a case kills it. `jobs`: number of processes; -1 for one per core, 1 for this process.
    """

    def __init__(self, jobs: int = -1) -> None:
        self._jobs = jobs

    @property
    def slots(self) -> int:
        """Number of processes."""
        from joblib import cpu_count  # which takes NumPy along, and help needs neither

        return cpu_count() if self._jobs == -1 else self._jobs

    def run(
        self, work: Work, cases: Sequence[Case], store: Store, notify: Callable[[str], None]
    ) -> Generator[Finished]:
        """Run cases, and yield each as it ends; see `Executor`."""
        if self._jobs == 1:
            yield from (perform(work, case, store) for case in cases)
            return
        waiting = list(reversed(cases))
        free = [_Slot() for _ in range(min(self.slots, len(cases)))]
        running: dict[Future[Finished], tuple[_Slot, Case]] = {}
        try:
            while waiting or running:
                while waiting and free:
                    slot, case = free.pop(), waiting.pop()
                    running[slot.submit(work, case, store)] = slot, case
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    slot, case = running.pop(future)
                    free.append(slot)
                    try:
                        yield future.result()
                    except BrokenProcessPool:
                        slot.end()
                        yield Finished(Outcome(case, error=DIED))
        finally:
            for slot in (*free, *(slot for slot, _ in running.values())):
                slot.end()


class _Slot:
    """A process that runs one case after the other, and its successors.

    A pool's own ``max_tasks_per_child`` may wait for ever (CPython gh-115634), and a pool of
    several cannot tell which case killed a process.
    """

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._processes: set[BaseProcess] = set()
        self._cases = 0

    def submit(self, work: Work, case: Case, store: Store) -> "Future[Finished]":
        if self._cases == CASES_PER_PROCESS:
            self.end()
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                1, get_context("spawn"), initializer=follow_parent, initargs=(os.getpid(),)
            )
        from joblib import wrap_non_picklable_objects

        self._cases += 1
        others = set(active_children())
        with keeping_ctrl_c(), _single_threaded(), _without_script():
            future = self._pool.submit(perform, wrap_non_picklable_objects(work), case, store)
        self._processes |= set(active_children()) - others
        return future

    def end(self) -> None:
        """End the process at once, in the middle of a case, too."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        for process in self._processes:
            process.kill()
        self._pool, self._cases = None, 0
        self._processes.clear()


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Start processes inside whose libraries compute with one thread."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ |= dict.fromkeys(THREADS, "1")
    try:
        yield
    finally:
        for name, value in before.items():
            del os.environ[name]
            if value is not None:
                os.environ[name] = value


@contextmanager
def _without_script() -> Iterator[None]:
    """Start processes inside that do not run this process's script again, to import it."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@contextmanager
def keeping_ctrl_c() -> Iterator[None]:
    """Start processes inside that Ctrl-C never reaches; this one receives it after the block."""
    ensure_running()  # Python lets Ctrl-C through again when it starts its tracker of resources
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def follow_parent(parent: int) -> None:
    """Leave Ctrl-C to the parent process, given by its number, and end with it however it ends."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=watch, daemon=True).start()
