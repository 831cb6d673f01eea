"""Executor of a study on the workers of a Dask scheduler, and a case as a task of a worker."""

import os
import pickle
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count

import cloudpickle
from distributed import CancelledError, Client, Future, KilledWorker, get_worker, wait

from sonoservo.diagrams.studies.fingerprint import describe_differences, package_identity
from sonoservo.diagrams.studies.processes import THREADS
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
from sonoservo.systems.files.refusals import ConfigurationError, shorten

_LOOK_S = 1.0  # time in s between two looks at which workers there are

_LEAVE_S = 1.0
"""Time in s from the end of a worker's last case until it makes way for another one; the result has
been fetched by then."""

_cases = count(1)


@dataclass(frozen=True)
class Refusal:
    """Answer of a worker whose package differs: its address, and its `package_identity`."""

    worker: str
    identity: Mapping[str, str]


def run_case(message: bytes, identity: Mapping[str, str], limit: float) -> Finished | Refusal:
    """Run a pickled case in a worker's process, with one thread.

    The process ends if the case takes longer than the limit in s, as if it had crashed, and is
    replaced after some cases, because a run leaves memory behind.
    """
    os.environ.update(dict.fromkeys(THREADS, "1"))  # before the libraries are imported
    worker = get_worker()
    if package_identity() != identity:
        return Refusal(worker.address, package_identity())
    work, store, case = pickle.loads(message)
    watch = threading.Timer(limit, os._exit, [1])
    watch.daemon = True
    watch.start()
    try:
        return perform(work, case, store)
    finally:
        watch.cancel()
        if next(_cases) >= CASES_PER_PROCESS and worker.nanny is not None:
            worker.loop.add_callback(
                worker.loop.call_later, _LEAVE_S, worker.close_gracefully, restart=True
            )


class Cluster:
    """Executor on the workers of a Dask scheduler, one case at a time each.

    A case may take ``limit`` s. After ``patience`` s without an answer the scheduler is considered
    gone. A worker whose package differs gets no cases.
    """

    # A nanny replaces a worker that dies, and the scheduler runs its case again elsewhere, up to
    # ``distributed.scheduler.allowed-failures``.

    def __init__(self, client: Client, *, limit: float, patience: float = 15.0) -> None:
        self._client, self._limit, self._patience = client, limit, patience
        self._workers: list[str] = []
        self._refused: dict[str, str] = {}
        self._looked = -_LOOK_S
        self._answered = time.monotonic()

    @property
    def slots(self) -> int:
        """Number of cases that can run at the same time now."""
        return len(self._workers)

    @property
    def dashboard(self) -> str:
        """Address of the scheduler's dashboard."""
        return str(self._client.dashboard_link)

    def run(
        self, work: Work, cases: Sequence[Case], store: Store, notify: Callable[[str], None]
    ) -> Generator[Finished]:
        """Run cases, and yield each as it ends; see `Executor`."""
        kept_there = store if store.shared else None
        waiting, running = deque(cases), dict[Future, Case]()
        try:
            while waiting or running:
                self._look(running)
                while waiting and len(running) < self.slots:
                    case = waiting.popleft()
                    running[self._submit(cloudpickle.dumps((work, kept_there, case)))] = case
                for future in self._ended(running):
                    case = running.pop(future)
                    reply = self._collect(future, case)
                    if isinstance(reply, Finished):
                        yield reply
                        continue
                    waiting.appendleft(case)
                    if isinstance(reply, Refusal):
                        self._refuse(reply, notify)
        finally:
            self._end(running)

    def _submit(self, message: bytes) -> Future:
        return self._client.submit(
            run_case,
            message,
            package_identity(),
            self._limit,
            key=f"sonoservo-{uuid.uuid4().hex}",
            workers=self._workers if self._refused else None,
            pure=False,
        )

    def _look(self, running: Collection[Future]) -> None:
        """Ask the scheduler from time to time which workers there are."""
        now = time.monotonic()
        if now - self._looked < _LOOK_S:
            return
        try:
            there = self._client.nthreads(callback_timeout=self._patience)
            self._answered = time.monotonic()
        except (OSError, TimeoutError, AttributeError) as error:  # None while it reconnects
            if self._client.status == "closed" or now - self._answered > self._patience:
                raise ConnectionError(
                    "the cluster's scheduler is gone; finished cases are kept, and the same "
                    "command goes on with the others"
                ) from error
            there = {}
        self._looked = time.monotonic()
        gone, self._workers = set(self._workers), [n for n in there if n not in self._refused]
        if self._refused and gone - set(self._workers):
            self._free_stranded(running)
        if not self._workers and self._refused.keys() & there.keys():
            worker, reason = next(iter(self._refused.items()))
            raise ConfigurationError(f"no worker can run the cases; {worker}: {reason}")

    def _free_stranded(self, running: Collection[Future]) -> None:
        """Cancel cases that wait for workers which are gone; a nanny's next one is another one."""
        held = {key for keys in self._client.processing().values() for key in keys}
        self._client.cancel([each for each in running if not each.done() and each.key not in held])

    def _ended(self, running: Collection[Future]) -> list[Future]:
        """Return the cases that have ended, after waiting for the first of them for a while."""
        if not running:
            time.sleep(_LOOK_S)
        else:
            with suppress(TimeoutError, CancelledError), self._client.as_current():
                wait(list(running), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
        return [each for each in running if each.done()]

    def _collect(self, future: Future, case: Case) -> Finished | Refusal | None:
        """Return a worker's answer to a case; None if the case is to be run again."""
        try:
            reply: Finished | Refusal = future.result(timeout=self._patience)
            return reply
        except KilledWorker:
            return Finished(Outcome(case, error=DIED))
        except (CancelledError, OSError, TimeoutError):  # the scheduler may be gone
            self._looked = -_LOOK_S
            return None
        except Exception as error:
            raise ConfigurationError(
                f"no worker can run the cases; {type(error).__name__}: {error}"
            ) from error
        finally:
            future.release()

    def _refuse(self, refusal: Refusal, notify: Callable[[str], None]) -> None:
        """Give a worker no more cases, and say why."""
        reason = describe_differences(refusal.identity, package_identity())
        if refusal.worker not in self._refused:
            self._refused[refusal.worker] = reason
            notify(shorten(f"{refusal.worker} gets no cases: {reason}"))
        self._workers = [each for each in self._workers if each != refusal.worker]
        self._looked = -_LOOK_S

    def _end(self, running: Collection[Future]) -> None:
        """Leave no case behind: their workers are replaced."""
        if not running or self._client.status != "running":
            return
        keys = {each.key for each in running}
        busy: Mapping[str, Sequence[str]] = self._client.processing()
        theirs = [worker for worker, held in busy.items() if keys & set(held)]
        self._client.cancel(list(running), force=True)
        if theirs:
            self._client.restart_workers(theirs, timeout=self._patience, raise_for_error=False)
