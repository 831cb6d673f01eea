"""Results of a run, which print and draw themselves."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from sonoservo.systems.evaluation.labels import look_up
from sonoservo.systems.evaluation.reports.plots import png
from sonoservo.systems.evaluation.reports.report import Story, report_body, told, write_report
from sonoservo.systems.evaluation.reports.verdict import Verdict, reasons_text
from sonoservo.systems.evaluation.table import Table
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import Unwritten, write_atomically


@dataclass(frozen=True)
class RunResult:
    """Results of a run.

    Parameters
    ----------
    summary
        Figures, as in summary.json.
    log
        Log of the run; its class depends on the experiment.
    labels
        Label of each figure of the summary that tables show, by its dotted path.
    results
        Further results of the experiment, by name: shape prediction has the last `shape`.
    failure
        What ended the run early, as a tracker of one's own that failed, or else the error of the
        first file that could not be written; None if there was neither.
    verdict
        Verdict on the run in words; None if nothing judged it.
    published
        Published figures to compare with, by their dotted paths into the summary.
    plots
        Caption and figure of each plot of the run, by name.
    """

    summary: dict[str, Any]
    log: Any
    labels: Mapping[str, str]
    results: Mapping[str, Any] = field(default_factory=dict)
    failure: OSError | ConfigurationError | None = None
    verdict: Verdict | None = None
    published: Mapping[str, float] = field(default_factory=dict)
    plots: Mapping[str, tuple[str, Figure]] = field(default_factory=dict)

    def plot(self) -> Figure:
        """Return the run's first plot, which a notebook shows, if it was long enough."""
        if not self.plots:
            raise ValueError("the run was too short for a plot")
        _, figure = next(iter(self.plots.values()))
        return figure

    def write_report(
        self,
        out: Path,
        unwritten: Unwritten,
        story: Story,
        key_frames: Mapping[str, Figure] = MappingProxyType({}),
    ) -> None:
        """Write the plots, and report.html with a story; collect the errors of files."""
        images = {}
        for name, (caption, figure) in self.plots.items():
            images[caption] = png(figure)
            with unwritten.collect():
                write_atomically(out / name, images[caption])
        with unwritten.collect():
            write_report(
                out / "report.html",
                self.summary,
                images,
                story=replace(story, verdict=self.verdict),
                key_frames={caption: png(figure) for caption, figure in key_frames.items()},
                labels=self.labels,
                paper=self.published,
            )

    def __str__(self) -> str:
        return table_text(summary_table(self))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return report_body(
            self.summary,
            story=Story(verdict=self.verdict),
            labels=self.labels,
            paper=self.published,
        )


def summary_table(result: RunResult) -> TerminalTable:
    """Return the figures of a run beside the published ones, for a terminal."""
    summary, published = result.summary, result.published
    caption, stops = Text(), stops_text(summary)
    if result.verdict is not None:
        caption.append(f"{result.verdict.headline}.", style="bold not italic")
        caption.append(f" {result.verdict.text}" + ("\n" if stops else ""))
    caption.append(stops)
    rows = [
        [label, look_up(summary, path), published.get(path)]
        for path, label in told(summary, result.labels).items()
    ]
    table = Table(["quantity", "this run", "paper"], rows).without_empty_columns()
    shown = table.terminal(f"{summary['scenario']}, seed {summary['seed']}", widest=None)
    shown.caption, shown.caption_justify = caption or None, "left"
    return shown


def table_text(table: TerminalTable) -> str:
    """Return a table as plain text, as a terminal shows it."""
    console = Console(width=100, color_system=None, force_jupyter=False)
    with console.capture() as captured:
        console.print(table)
    return captured.get()


def end_words(result: RunResult) -> str:
    """Return the end of a run in words, for its page."""
    if result.verdict is not None:
        return f"{result.verdict.headline}. {result.verdict.text}"
    return f"{result.summary.get('simulated_s', 0.0):.1f} s simulated"


def stops_text(summary: Mapping[str, Any]) -> str:
    """Return why a run was stopped, volumes were refused or gave no needle; may be empty."""
    lines = []
    reasons, at_end = (look_up(summary, f"guard.{key}") for key in ("reasons", "stopped_at_end"))
    if reasons:
        lines.append(f"stopped {'' if at_end else 'for a while '}because {reasons}")
    if at_end:
        lines.append(f"still stopped at the end because {at_end}")
    lines += filter(None, (look_up(summary, f"guard.{key}") for key in ("noticed", "refusal")))
    if reasons := look_up(summary, "tracking.reasons"):
        lines.append(f"Volumes without a needle: {reasons_text(reasons)}")
    return "\n".join(lines)
