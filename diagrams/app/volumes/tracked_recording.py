"""Results of tracking in a recording, which print and draw themselves, and their files."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sonoservo.diagrams.app.run_result import table_text
from sonoservo.diagrams.app.terminal import mode_table
from sonoservo.diagrams.app.volumes.estimates_table import estimates_csv
from sonoservo.systems.evaluation.labels import LABELS, recording_labels
from sonoservo.systems.evaluation.log import write_log
from sonoservo.systems.evaluation.reports.plots import ERRORS_CAPTION, plot_errors, png
from sonoservo.systems.evaluation.reports.report import Story, report_body, write_report
from sonoservo.systems.evaluation.reports.track_plots import (
    PLANES_CAPTION,
    TIP_CAPTION,
    VolumePictures,
    plot_planes,
    plot_tip,
)
from sonoservo.systems.evaluation.reports.verdict import recording_verdict
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.writing import Unwritten, write_atomically, write_json
from sonoservo.systems.signals.needle_estimate import NeedleEstimate


@dataclass(frozen=True, eq=False)
class TrackedRecording:
    """Results of tracking in a recording.

    `estimates` are in W, `times` in s and lengths of the needle `in_view` in m, one for each
    volume; `rows` are those of ``estimates.csv``, in the file's own LPS in mm; `summary` has the
    figures of summary.json. The log is like that of a run, with the truth beside the recording, if
    any. `failure` is the error of the first file that could not be written.
    """

    estimates: list[NeedleEstimate]
    rows: list[dict[str, Any]]
    summary: dict[str, Any]
    log: RunLog
    times: Sequence[float] = ()
    in_view: Sequence[float] = ()
    pictures: Sequence[VolumePictures] = field(default=(), repr=False)
    failure: OSError | None = None

    def plots(self) -> dict[str, tuple[str, Figure]]:
        """Return caption and figure of each plot, by the name of its file; none if interrupted."""
        if not self.rows:
            return {}
        p_LTip = 1e-3 * np.array([[row[f"tip_{axis}_mm"] for axis in "lps"] for row in self.rows])
        tip = plot_tip(np.array(self.times), self.estimates, p_LTip, np.array(self.in_view))
        plots = {
            "planes.png": (PLANES_CAPTION, plot_planes(list(self.pictures))),
            "tip.png": (TIP_CAPTION, tip),
        }
        if self.summary["truth"]:
            plots["errors.png"] = ERRORS_CAPTION, plot_errors(self.log)
        return plots

    def plot(self) -> Figure:
        """Return the plot of the estimated tip, which a notebook shows, if there is one."""
        if not self.rows:
            raise ValueError("no volume was tracked, so there is nothing to plot")
        return self.plots()["tip.png"][1]

    def write(self, out: Path, command: str, unwritten: Unwritten) -> None:
        """Write the results, and the command that repeats them; collect the errors of files."""
        with unwritten.collect():
            write_json(out / "summary.json", self.summary)
            write_atomically(out / "estimates.csv", estimates_csv(self.rows))
            write_json(out / "estimates.json", self.rows)
            write_log(out / "log.npz", self.log)
        plots = {name: (caption, png(figure)) for name, (caption, figure) in self.plots().items()}
        if not plots:
            return
        with unwritten.collect():
            for name, (_, image) in plots.items():
                write_atomically(out / name, image)
            write_report(
                out / "report.html", self.summary, dict(plots.values()),
                story=self._story(command), labels=self._labels(),
            )  # fmt: skip

    def _story(self, command: str = "") -> Story:
        return Story(verdict=recording_verdict(self.summary), command=command)

    def _labels(self) -> dict[str, str]:
        return recording_labels(self.summary["modes"]) | LABELS

    def __str__(self) -> str:
        return table_text(mode_table(self.summary))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return report_body(self.summary, story=self._story(), labels=self._labels())
