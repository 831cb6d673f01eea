"""Runs of a study on an executor, with outcomes kept on disk and failures isolated."""

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sonoservo.diagrams.studies.fingerprint import made_by
from sonoservo.diagrams.studies.processes import Processes
from sonoservo.diagrams.studies.store import Store
from sonoservo.diagrams.studies.study import (
    Case,
    Executor,
    Finished,
    Outcome,
    StudyOptions,
    Work,
)
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import claim_folder, to_plain, write_json


class StudyProgress:
    """Progress bar of a study, which also shows lines of text above it; a context manager."""

    def __init__(
        self,
        console: Console | None,
        executor: Executor,
        pending: Sequence[Case],
        known: Sequence[Outcome],
    ) -> None:
        self._executor, self._began = executor, time.monotonic()
        self._ended, self._failed = 0, sum(not each for each in known)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            TextColumn("{task.fields[status]}"),
            TimeRemainingColumn(),
            console=console or Console(quiet=True),
            refresh_per_second=1,
            speed_estimate_period=float("inf"),  # a case may take minutes
        )
        total = len(pending) + len(known)
        self._task = self._bar.add_task("starting", total=total, completed=len(known), status="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def notify(self, line: str) -> None:
        """Show a line of text above the bar."""
        self._bar.console.print(line, markup=False, soft_wrap=True)

    def advance(self, outcome: Outcome) -> None:
        """Count a case that ended, and show its failure."""
        self._ended += 1
        if not outcome:
            self._failed += 1
            self.notify(f"{outcome.case.name} failed: {outcome.error}")
        rate = 60 * self._ended / max(time.monotonic() - self._began, 1.0)
        status = f"{rate:.3g}/min, {self._executor.slots} at once, {self._failed} failed"
        name = outcome.case.experiment
        self._bar.update(self._task, advance=1, description=name, status=status)


def run_cases(
    work: Work,
    cases: Sequence[Case],
    folder: Path,
    *,
    jobs: int = -1,
    cluster: Executor | None = None,
    store: Store | None = None,
    console: Console | None = None,
) -> list[Outcome]:
    """Run every case that has not been run yet, several at a time.

    Each outcome is kept in a file of its own. It is read again if the same code (all that the
    module of ``work`` imports) made it with the same settings, and its files are in the store.

    Parameters
    ----------
    work
        Importable function, or a partial of one, that runs a case and returns what to keep. Any
        exception makes the case a failure.
    cases
        Cases to run, all different.
    folder
        Folder of the outcomes.
    jobs
        Number of processes; -1 for one per core, 1 to run the cases in this process.
    cluster
        Cluster to run the cases on instead, from `open_cluster`.
    store
        Store of the files of results; by default, ``folder``.
    console
        Console on which to show progress, if any.

    Returns
    -------
    The outcomes, in the order of the cases.

    Raises
    ------
    ValueError
        If two cases are equal.
    ConfigurationError
        If another process uses the folder, or no worker of the cluster has the same package.
    ConnectionError
        If the cluster's scheduler is gone; finished outcomes are kept.
    KeyboardInterrupt
        If interrupted; finished outcomes are kept.
    """
    if len(set(cases)) < len(cases):
        raise ValueError(f"{len(cases)} cases, of which {len(set(cases))} differ; all must differ")
    with claim_folder(folder):
        kept = _Kept(folder, store or Store(str(folder)), made_by(_module_of(work)))
        outcomes = {case: kept.read(case) for case in cases}
        pending = [case for case, outcome in outcomes.items() if outcome is None]
        pending.sort(key=lambda case: case.seed)  # if interrupted, all experiments have some runs
        known = [outcome for outcome in outcomes.values() if outcome is not None]
        executor = cluster or Processes(jobs)
        with StudyProgress(console, executor, pending, known) as progress:
            running = executor.run(work, pending, kept.store, progress.notify)
            try:
                for finished in running:
                    outcome = kept.write(finished)
                    outcomes[outcome.case] = outcome
                    progress.advance(outcome)
            finally:
                running.close()
    return [outcome for outcome in outcomes.values() if outcome is not None]


def run_study(
    work: Work,
    cases: Sequence[Case],
    options: StudyOptions,
    *,
    folder: str = "cases",
    logs: Path | None = None,
) -> list[Outcome]:
    """Run the cases of a study that its options ask for; see `run_cases`."""
    chosen = [each for each in cases if each.experiment.startswith(options.only)]
    if not chosen:
        known = ", ".join(dict.fromkeys(each.experiment for each in cases))
        raise ConfigurationError(f"--only: no experiment begins with {options.only!r}; {known}")
    if options.choose:
        chosen = [*options.choose(chosen)]
    outcomes = run_cases(
        work,
        chosen,
        options.folder / folder,
        jobs=options.jobs,
        cluster=options.cluster,
        store=None if logs is None else Store(str(logs)),
        console=options.console,
    )
    if not outcomes:
        raise ConfigurationError(f"--finished: no run by this code is in {options.folder}")
    return outcomes


class _Kept:
    """Outcomes on disk, and the store of their files."""

    def __init__(self, folder: Path, store: Store, made_by: Mapping[str, str]) -> None:
        self._folder, self.store, self._made_by = folder, store, made_by

    @cached_property
    def _sizes(self) -> Mapping[str, int]:
        return self.store.sizes()

    def _path(self, case: Case) -> Path:
        return self._folder / f"{case.name}.json"

    def write(self, finished: Finished) -> Outcome:
        """Write a case's files, then its outcome; one that cannot be written is made again."""
        outcome, lasting = replace(finished.outcome, made_by=self._made_by), finished.lasting
        try:
            self.store.write(finished.files)
        except OSError as error:
            outcome = replace(
                outcome, result={}, files={}, error=f"{type(error).__name__}: {error}"
            )
            lasting = False
        if lasting:
            content = to_plain(asdict(outcome))
            with suppress(OSError):
                write_json(self._path(outcome.case), {**content, "sha256": _digest(content)})
        return outcome

    def read(self, case: Case) -> Outcome | None:
        """Read a case's outcome; None unless it is whole, and by the present code and libraries."""
        try:
            kept = json.loads(self._path(case).read_text(encoding="utf-8"))
            intact = kept.pop("sha256") == _digest(kept)
            if not intact or kept["made_by"] != self._made_by:
                return None
            if kept.pop("case") != asdict(case):
                return None
            outcome = Outcome(case, **kept)
            files = outcome.files.items()
            whole = all(self._sizes.get(name) == file["bytes"] for name, file in files)
            return outcome if whole else None
        except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
            return None


def _module_of(work: Work) -> str:
    """Return the name of the module that defines the function that runs a case."""
    while isinstance(work, partial):
        work = work.func
    return work.__module__


def _digest(content: Mapping[str, Any]) -> str:
    """Return the digest of an outcome's contents, by which an altered file is noticed."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
