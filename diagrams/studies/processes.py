"""Executor of a study on the cores of this machine, with joblib."""

import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures.process import BrokenProcessPool
from functools import partial

from joblib import Parallel, delayed, effective_n_jobs, parallel_config
from joblib.externals.loky import get_reusable_executor

from sonoservo.diagrams.studies.follow_parent import follow_parent, keeping_ctrl_c
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


class Processes:
    """Executor on the cores of this machine.

    Drake's Python systems are never freed, so the cases run in rounds, each in fresh processes.
    Each process computes with one thread. A case that kills its process is identified by running
    the cases again one by one.

    Parameters
    ----------
    jobs
        Number of processes; -1 for one per core, 1 to run the cases in this process.
    """

    def __init__(self, jobs: int = -1) -> None:
        self._jobs = jobs

    @property
    def slots(self) -> int:
        """Number of processes."""
        return effective_n_jobs(self._jobs)

    def run(
        self,
        work: Work,
        cases: Sequence[Case],
        store: Store,
        notify: Callable[[str], None],
    ) -> Generator[Finished]:
        """Run cases, and yield each as it ends; see `Executor`."""
        pending = dict.fromkeys(cases)
        most = together = CASES_PER_PROCESS * self.slots
        while pending:
            batch = list(pending)[:together]
            try:
                for each in _run_round(work, batch, store, self._jobs if together > 1 else 2):
                    del pending[each.outcome.case]
                    yield each
                together = most
            except BrokenProcessPool:
                if together == 1:
                    del pending[batch[0]]
                    yield Finished(Outcome(batch[0], error=DIED))
                    together = most
                else:
                    together = 1


def _run_round(work: Work, cases: list[Case], store: Store, jobs: int) -> Generator[Finished]:
    with (
        parallel_config(
            "loky",
            n_jobs=jobs,
            inner_max_num_threads=1,
            initializer=partial(follow_parent, os.getpid()),
        ),
        keeping_ctrl_c(),
    ):
        finished = Parallel(return_as="generator_unordered", batch_size=1)(
            delayed(perform)(work, case, store) for case in cases
        )
    try:
        yield from finished
    finally:
        finished.close()
        get_reusable_executor(kill_workers=True).shutdown(kill_workers=True)
