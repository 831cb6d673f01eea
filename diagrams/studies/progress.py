"""Progress of a study: a bar with rate, workers, failures and the time left."""

import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

from sonoservo.diagrams.studies.study import Case, Executor, Outcome

_PRIOR_S = 15.0  # wall-clock time in s that a case is expected to take before any has ended
_PRIOR_WEIGHT = 1.0  # number of ended cases that the expected time counts as

_PATIENCE = 1.5
"""Expected time of a case that runs, relative to the time for which no case has ended."""

_PERIOD = 1.0  # time in s between two updates of the bar


class TimeLeft:
    """Estimate of the time until the end of a study, from the first second on.

    A case is expected to take the mean of those that ended in its experiment, of which one with the
    mean of all experiments is assumed from the beginning; and among those, one of 15 s. If none has
    ended for a time t, the cases that run are expected to take 1.5 t at least.

    `pending`: cases to run; `known`: outcomes of earlier runs of the study; `clock`: clock in s.
    """

    def __init__(
        self,
        pending: Iterable[Case],
        known: Iterable[Outcome] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._left = Counter(case.experiment for case in pending)
        self._ended: Counter[str] = Counter()
        self._seconds: dict[str, float] = defaultdict(float)
        self._last = clock()
        for outcome in known:
            self._count(outcome)

    def ended(self, outcome: Outcome) -> None:
        """Count a case that ended."""
        self._left[outcome.case.experiment] -= 1
        self._count(outcome)
        self._last = self._clock()

    def seconds(self, slots: int) -> float | None:
        """Return the time left in s; None if no case can run."""
        left = self._left.total()
        slots = min(slots, left)
        if slots < 1:
            return None if left else 0.0
        waited = self._clock() - self._last
        least = _PATIENCE * waited
        mean = max(_posterior(_PRIOR_S, sum(self._seconds.values()), self._ended.total()), least)
        work = sum(
            count * max(_posterior(mean, self._seconds[name], self._ended[name]), least)
            for name, count in self._left.items()
        )
        return max(work / slots - waited, 0.0)

    def _count(self, outcome: Outcome) -> None:
        self._ended[outcome.case.experiment] += 1
        self._seconds[outcome.case.experiment] += outcome.wall_s


def _posterior(prior: float, seconds: float, ended: int) -> float:
    return (_PRIOR_WEIGHT * prior + seconds) / (_PRIOR_WEIGHT + ended)


class StudyProgress:
    """Progress bar of a study, which also shows lines of text above it."""

    def __init__(
        self,
        console: Console | None,
        executor: Executor,
        pending: Sequence[Case],
        known: Sequence[Outcome],
    ) -> None:
        self._console = console or Console(quiet=True)
        self._executor, self._known = executor, known
        self._left = TimeLeft(pending, known)
        self._began, self._ended, self._failed = time.monotonic(), 0, sum(not e for e in known)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=12),
            MofNCompleteColumn(),
            _StatusColumn(self),
            console=self._console,
            refresh_per_second=1 / _PERIOD,
        )
        total = len(pending) + len(known)
        self._task = self._bar.add_task("starting", total=total, completed=len(known))

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def notify(self, line: str) -> None:
        """Show a line of text above the bar."""
        self._console.print(line, markup=False, soft_wrap=True)

    def advance(self, outcome: Outcome) -> None:
        """Count a case that ended, and show its failure."""
        self._ended += 1
        self._left.ended(outcome)
        if not outcome:
            self._failed += 1
            self.notify(f"{outcome.case.name} failed: {outcome.error}")
        self._bar.update(self._task, advance=1, description=outcome.case.experiment)

    def status(self) -> str:
        """Return rate, workers, failures and the time left as text."""
        slots = self._executor.slots
        rate = 60 * self._ended / max(time.monotonic() - self._began, _PERIOD)
        left = self._left.seconds(slots)
        time_left = "no workers yet" if left is None else f"~{_duration(left)} left"
        return f"{rate:.3g}/min, {slots} at once, {self._failed} failed, {time_left}"


class _StatusColumn(ProgressColumn):
    """Column of the bar with its status, renewed whenever it is drawn."""

    def __init__(self, progress: StudyProgress) -> None:
        super().__init__()
        self._progress = progress

    def render(self, task: Task) -> Text:
        """Return the text of the column."""
        return Text(self._progress.status())


def _duration(seconds: float) -> str:
    """Return a time as a person says it: "40 s", "12 min", "3.4 h" or "2.1 days"."""
    for size, unit, digits in ((86400, "days", 1), (3600, "h", 1), (60, "min", 0)):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.{digits}f} {unit}"
    return f"{seconds:.0f} s"


class Heartbeat:
    """Prints every few seconds how long something has taken, unless the console is a terminal."""

    def __init__(self, console: Console, what: str, period: float = 5.0) -> None:
        self._console, self._what, self._period = console, what, period
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Self:
        self._console.print(f"{self._what} ...")
        if not self._console.is_terminal:
            self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _beat(self) -> None:
        began = time.monotonic()
        while not self._over.wait(self._period):
            self._console.print(f"{self._what} ... {time.monotonic() - began:.0f} s")
