"""Progress of a study: a bar with rate, workers, failures and the time left."""

import time
from collections.abc import Sequence
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sonoservo.diagrams.studies.study import Case, Executor, Outcome


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
