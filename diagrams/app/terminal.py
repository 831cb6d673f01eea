"""Output in the terminal: progress during a run, and figures at its end."""

from collections.abc import Mapping, Sequence
from typing import Any, Self

import typer
from numba.core.event import Event, Listener, register, unregister
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress
from rich.table import Table as TerminalTable
from rich.text import Text

from sonoservo.diagrams.app.run_result import RunResult
from sonoservo.diagrams.scenario import Scenario
from sonoservo.diagrams.studies.study_report import Study, rows_table
from sonoservo.systems.evaluation.compile_free_clock import COMPILATION
from sonoservo.systems.evaluation.labels import LABELS, look_up, recording_labels
from sonoservo.systems.evaluation.source_checks import Finding, Grade, sort_findings
from sonoservo.systems.evaluation.success import RunOutcome, run_outcome
from sonoservo.systems.evaluation.table import Table
from sonoservo.systems.files.counting import counted


def end_run(result: RunResult) -> None:
    """Raise a file's error, if any; exit with 3 if stopped by the guard, or never in contact."""
    if result.failure is not None:
        raise result.failure
    if run_outcome(result.summary) in (RunOutcome.STOPPED, RunOutcome.UNTOUCHED):
        raise typer.Exit(3)


# Columns that a terminal of fewer than 120 characters has no room for.
_NEEDS_WIDTH = ("ours, estimated", "as published, estimated", "as published, 95 %")


def study_table(study: Study, width: int) -> TerminalTable:
    """Return the rows of a study, for a terminal of so many characters in a line."""
    table = rows_table(study.rows).grouped()
    if width < 120:
        table = table.without(_NEEDS_WIDTH)
    failed = sum(not each for each in study.outcomes)
    return table.without_empty_columns().terminal(
        f"{study.paper} reproduced", f"{len(study.outcomes)} runs, {failed} failed"
    )


class Progress(Listener):
    """Progress bar with a state in words; a context manager.

    It says when kernels are being compiled. A console that shows no bar gets a line each instead.
    `begun` says what begins, and `counted` is the format of how much of the total is done.
    """

    def __init__(
        self, console: Console, name: str, total: float, *, begun: str, counted: str
    ) -> None:
        self._console, self._name, self._total = console, name, total
        self._begun, self._counted = begun, counted
        self._seen, self._compiled = console.is_terminal or console.is_jupyter, False
        self._bar = RichProgress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[state]}", markup=False),
            TimeRemainingColumn(),
            console=console,
        )
        self._task = self._bar.add_task("starting ...", total=total, state="")

    def __enter__(self) -> Self:
        register(COMPILATION, self)
        if self._seen:
            self._bar.start()
        else:
            self._console.print(f"{self._begun} ...")
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        unregister(COMPILATION, self)
        if self._seen:
            nothing = kind is not None and not self._bar.tasks[0].completed
            self._bar.update(self._task, visible=not nothing)
            self._bar.stop()

    def on_start(self, event: Event) -> None:
        """Say that kernels are being compiled."""
        words = "compiling kernels, once on this machine ..."
        self._bar.update(self._task, description=words)
        if not (self._seen or self._compiled):
            self._console.print(words.capitalize())
        self._compiled = True

    def on_end(self, event: Event) -> None:
        """Leave what was said until the next step."""

    def show(self, done: float, state: str = "") -> None:
        """Move the bar, and show a state."""
        state = f"{self._counted.format(done, self._total)}  {state}"
        self._bar.update(self._task, description=self._name, completed=done, state=state)


def run_progress(console: Console, scenario: Scenario) -> Progress:
    """Return the progress bar of a run; it is shown the simulated time in s."""
    name, duration = scenario.name, scenario.duration
    begun = f"Simulating {name}, {duration:g} s"
    return Progress(console, name, duration, begun=begun, counted="{:5.1f} of {:g} s")


def volume_progress(console: Console, act: str, name: str, count: int) -> Progress:
    """Return the progress bar of what acts on volumes; it is shown how many are done."""
    begun = f"{act} {name}, {counted(count, 'volume')}"
    return Progress(console, name, count, begun=begun, counted="volume {} of {}")


def mode_words(summary: Mapping[str, Any]) -> str:
    """Return the numbers of volumes by mode in words, for a page."""
    modes = ", ".join(f"{mode} {count}" for mode, count in summary["modes"].items())
    return f"{counted(summary['volumes'], 'volume')}: {modes}"


def figures_table(
    summary: Mapping[str, Any], column: str, labels: Mapping[str, str], *further: tuple[str, int]
) -> TerminalTable:
    """Return the figures of a summary that have a value, and further rows, for a terminal."""
    figures = [(label, look_up(summary, path)) for path, label in labels.items()]
    rows = [*(each for each in figures if each[1] is not None), *further]
    return Table(["quantity", column], rows).terminal(str(summary["scenario"]), widest=None)


def mode_table(summary: Mapping[str, Any]) -> TerminalTable:
    """Return the figures of a tracked recording, for a terminal."""
    return figures_table(summary, "this recording", recording_labels(summary["modes"]) | LABELS)


_LIVE_ROWS = {
    "volumes": "volumes",
    "dropped": "dropped, because newer ones had arrived",
    "compute_ms.track.median": "tracking, median, ms",
    "latency_ms.total.median": "from the last byte to the estimate sent, median, ms",
    "latency_ms.total.p99": "from the last byte to the estimate sent, 99 %, ms",
    "latency_ms.besides_tracking.median": "the same without tracking, median, ms",
    "latency_ms.besides_tracking.p99": "the same without tracking, 99 %, ms",
}


def live_table(summary: Mapping[str, Any]) -> TerminalTable:
    """Return the figures of live tracking, for a terminal."""
    left_out = summary["left_out_reasons"].items()
    rows = [(f"left out: {reason}", count) for reason, count in left_out]
    for mode, count in summary["modes"].items():
        rows.append((f"volumes in the mode {mode}", count))
    return figures_table(summary, "this stream", _LIVE_ROWS, *rows)


def findings_table(findings: Sequence[Finding]) -> TerminalTable:
    """Return what a source was found to be, and what to do, for a terminal."""
    heads = ("check", "found", "what to do")[: 2 + any(each.advice for each in findings)]
    table = TerminalTable(*heads)
    styles = {Grade.FINE: "", Grade.DOUBTFUL: "yellow", Grade.WRONG: "bold red"}
    for each in sort_findings(findings):
        cells = (each.check.value, each.text, each.advice)
        table.add_row(*map(Text, cells[: len(heads)]), style=styles[each.grade])
    return table


def pose_error_table(figures: Mapping[str, Any]) -> TerminalTable:
    """Return the errors of a recording's poses with their standard deviations, for a terminal."""
    rows = [["delay, ms", figures["delay_ms"], figures["delay_std_ms"]]]
    for name, label, unit in (
        ("translation", "image displaced along", "mm"),
        ("rotation", "image turned about", "deg"),
    ):
        errors = zip("xyz", figures[f"{name}_{unit}"], figures[f"{name}_std_{unit}"], strict=True)
        rows += [[f"{label} {axis}, {unit}", *each] for axis, *each in errors]
    rows = [row if row[1] is not None else [row[0], "cannot be told", ""] for row in rows]
    table = Table(["quantity", "estimate", "standard deviation"], rows)
    return table.terminal("Errors of the poses", "x: lateral, y: depth, z: elevation", widest=None)
