"""The worker's side of a cluster: a case as a task of a Dask worker."""

import os
import pickle
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count

from distributed import get_worker

from sonoservo.diagrams.studies.fingerprint import package_identity
from sonoservo.diagrams.studies.processes import THREADS
from sonoservo.diagrams.studies.study import CASES_PER_PROCESS, Finished, perform

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
