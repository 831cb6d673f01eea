"""Executor of a study on the workers of a Dask scheduler."""

import queue
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cloudpickle
from distributed import CancelledError, Client, Future, KilledWorker

from sonoservo.diagrams.studies.cluster.worker import Reply, end_resting_processes, run_case
from sonoservo.diagrams.studies.fingerprint import describe_differences, package_identity
from sonoservo.diagrams.studies.store import Store
from sonoservo.diagrams.studies.study import DIED, Case, Finished, Outcome, Work
from sonoservo.systems.files.refusals import ConfigurationError, shorten

_LOOK_S = 1.0
"""Time in s between two looks at which workers there are."""

_GRACE_S = 60.0
"""Time in s beyond a case's limit after which its worker is considered frozen."""


@dataclass(eq=False)
class _Attempt:
    """A case on a worker."""

    case: Case
    number: int
    worker: str
    since: float
    future: Future


class Cluster:
    """Executor on the workers of a Dask scheduler.

    Every worker gets as many cases at a time as it has threads, and the next one when one ends. A
    case whose worker dies, leaves or takes too long is run again a few times, and the last time on
    a worker that runs nothing else, so that a case which kills its worker is told apart from its
    neighbours. A worker whose package differs from this process's gets no cases.

    Parameters
    ----------
    client
        Client of the scheduler.
    limit
        Longest time in s that a case may take.
    again
        Number of times that a lost case is run again.
    patience
        Time in s without an answer after which the scheduler is considered gone.
    """

    def __init__(
        self, client: Client, *, limit: float, again: int = 3, patience: float = 15.0
    ) -> None:
        self._client, self._limit, self._again, self._patience = client, limit, again, patience
        self._threads: Mapping[str, int] = {}
        self._refused: dict[str, str] = {}
        self._looked = -_LOOK_S
        self._answered = time.monotonic()

    @property
    def slots(self) -> int:
        """Number of cases that can run at the same time now."""
        return sum(self._threads.values())

    @property
    def dashboard(self) -> str:
        """Address of the scheduler's dashboard."""
        return str(self._client.dashboard_link)

    def run(
        self,
        work: Work,
        cases: Sequence[Case],
        store: Store,
        notify: Callable[[str], None],
    ) -> Generator[Finished]:
        """Run cases, and yield each as it ends; see `Executor`."""
        waiting = deque((case, 1) for case in cases)
        attempts: dict[str, _Attempt] = {}
        ended: queue.SimpleQueue[str] = queue.SimpleQueue()
        kept_there = store if store.shared else None
        try:
            while waiting or attempts:
                self._look(notify)
                for key in self._stray(attempts.items()):
                    ended.put(key)
                for case, number, worker in self._places(waiting, attempts.values()):
                    message = cloudpickle.dumps((work, kept_there, case))
                    key = f"sonoservo-{uuid.uuid4().hex}"
                    future = self._submit(message, worker, key)
                    attempts[key] = _Attempt(case, number, worker, time.monotonic(), future)
                    future.add_done_callback(lambda _, key=key: ended.put(key))
                keys = dict.fromkeys(_take(ended))
                done = {key: attempts.pop(key) for key in keys if key in attempts}
                replies = self._gather(done)
                for key, attempt in done.items():
                    reply = replies.get(key) or self._collect(attempt, notify)
                    if reply.kind == "finished":
                        yield reply.content
                    elif reply.kind == "refused":
                        self._refuse(attempt.worker, reply.content, notify)
                        waiting.appendleft((attempt.case, attempt.number))
                    elif attempt.number <= self._again:
                        again = f"{reply.content} ({attempt.worker}); runs again"
                        notify(f"{attempt.case.name}: {again}")
                        waiting.append((attempt.case, attempt.number + 1))
                    else:
                        yield Finished(Outcome(attempt.case, error=reply.content))
        finally:
            self._end(attempts.values())

    def _submit(self, message: bytes, worker: str, key: str) -> Future:
        return self._client.submit(
            run_case,
            message,
            package_identity(),
            self._limit,
            key=key,
            workers=[worker],
            allow_other_workers=False,
            pure=False,
        )

    def _look(self, notify: Callable[[str], None]) -> None:
        """Ask the scheduler from time to time which workers there are."""
        now = time.monotonic()
        if now - self._looked < _LOOK_S:
            return
        try:
            threads = self._client.nthreads(callback_timeout=self._patience)
            self._answered = time.monotonic()
        except (OSError, TimeoutError, AttributeError) as error:  # None while it reconnects
            if self._client.status == "closed" or now - self._answered > self._patience:
                raise ConnectionError(
                    "the cluster's scheduler is gone; finished cases are kept, and the same "
                    "command goes on with the others"
                ) from error
            threads = {}
        self._looked = time.monotonic()
        self._threads = {each: n for each, n in threads.items() if each not in self._refused}
        if self._refused and not self._threads and self._refused.keys() & threads.keys():
            worker, reason = next(iter(self._refused.items()))
            raise ConfigurationError(f"no worker can run the cases; {worker}: {reason}")

    def _stray(self, attempts: Iterable[tuple[str, _Attempt]]) -> list[str]:
        """Return the keys of the attempts whose worker is gone or does not answer."""
        latest = time.monotonic() - self._limit - _GRACE_S
        return [
            key
            for key, attempt in attempts
            if attempt.worker not in self._threads or attempt.since < latest
        ]

    def _places(
        self, waiting: deque[tuple[Case, int]], attempts: Iterable[_Attempt]
    ) -> Iterator[tuple[Case, int, str]]:
        """Take cases from those that wait, and yield each with its number and a free worker."""
        attempts = list(attempts)
        busy = Counter(attempt.worker for attempt in attempts)
        alone = {attempt.worker for attempt in attempts if attempt.number > self._again}
        free = [
            worker
            for worker, threads in self._threads.items()
            if worker not in alone
            for _ in range(threads - busy[worker])
        ]
        while waiting and free:
            case, number = waiting[0]
            if number <= self._again:
                worker = free.pop()
            else:
                empty = [each for each in free if not busy[each]]
                if not empty:
                    return
                worker = empty[0]
                free = [each for each in free if each != worker]
            waiting.popleft()
            busy[worker] += 1
            yield case, number, worker

    def _gather(self, attempts: Mapping[str, _Attempt]) -> Mapping[str, Reply]:
        """Fetch the replies of attempts that ended, in one request; without those that failed."""
        futures = {
            key: each.future for key, each in attempts.items() if each.future.status == "finished"
        }
        if not futures:
            return {}

        async def fetch() -> Mapping[str, Any]:
            found: Mapping[str, Any] = await self._client.gather(
                futures, errors="skip", asynchronous=True
            )
            return found

        try:
            replies = self._client.sync(fetch, callback_timeout=self._patience)
        except Exception:
            return {}
        return {key: reply for key, reply in replies.items() if isinstance(reply, Reply)}

    def _collect(self, attempt: _Attempt, notify: Callable[[str], None]) -> Reply:
        """Return the worker's reply, or that there is none."""
        future = attempt.future
        try:
            if not future.done():  # its worker is gone, or silent
                future.cancel()
                if attempt.worker in self._threads:
                    self._refuse(attempt.worker, "it does not answer any more", notify)
                return Reply("lost", DIED)
            reply: Reply = future.result(timeout=self._patience)
            return reply
        except (CancelledError, KilledWorker, OSError, TimeoutError, KeyError):
            return Reply("lost", DIED)
        except Exception as error:  # the worker cannot even begin
            return Reply("refused", f"{type(error).__name__}: {error}")
        finally:
            future.release()

    def _refuse(self, worker: str, reason: Any, notify: Callable[[str], None]) -> None:
        """Give a worker no more cases, and say why."""
        if isinstance(reason, Mapping):
            reason = describe_differences(reason, package_identity())
        if worker not in self._refused:
            self._refused[worker] = reason
            notify(shorten(f"{worker} gets no cases: {reason}"))
        self._threads = {each: n for each, n in self._threads.items() if each != worker}
        self._looked = -_LOOK_S

    def _end(self, attempts: Iterable[_Attempt]) -> None:
        """Leave no case and no process behind."""
        futures = [attempt.future for attempt in attempts]
        if self._client.status != "running":
            return
        if futures:
            self._client.cancel(futures, force=True, asynchronous=False)
        elif self._threads:
            self._client.run(end_resting_processes, workers=list(self._threads), on_error="ignore")


def _take(ended: "queue.SimpleQueue[str]") -> list[str]:
    """Return what is in a queue, after waiting for the first of it for a while."""
    taken: list[str] = []
    try:
        taken.append(ended.get(timeout=_LOOK_S))
        while True:
            taken.append(ended.get_nowait())
    except queue.Empty:
        return taken
