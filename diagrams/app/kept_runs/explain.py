"""Explanations of a tracker's decisions in the kept volumes of a run, as a table and as figures."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from sonoservo.diagrams.app.options import refusing_values
from sonoservo.systems.evaluation.explanation.explained_volume import (
    AFTER,
    BEFORE,
    FOLDER,
    ExplainedVolume,
    imaged_needle,
    read_explanations,
)
from sonoservo.systems.evaluation.explanation.explanation_sheet import plot_explanation
from sonoservo.systems.evaluation.log import read_log
from sonoservo.systems.evaluation.run_errors import estimate_errors
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.refusals import ConfigurationError

_TOLERANCE = 1.0  # Time in s before the first and after the last kept volume that is still accepted


@dataclass(frozen=True, eq=False)
class ExplainedRun:
    """Explained volumes of a run in order of time, at least one, and the run's log, if any."""

    folder: Path
    kept: list[ExplainedVolume]
    log: RunLog | None

    def tip_error(self, explained: ExplainedVolume) -> float:
        """Return the distance from the estimated to the true tip after a volume, in m, or NaN."""
        if self.log is None or not len(self.log.volume_time):
            return float("nan")
        number = int(np.abs(self.log.volume_time - explained.volume_time).argmin())
        if self.log.volume_time[number] != explained.volume_time:
            return float("nan")
        return float(estimate_errors(self.log).tip[number])

    def rows(self) -> list[dict[str, Any]]:
        """Return a row of figures for each kept volume."""
        return [self.row(each) for each in self.kept]

    def row(self, explained: ExplainedVolume) -> dict[str, Any]:
        """Return the figures of a kept volume."""
        return {
            "time_s": float(explained.volume_time),
            "mode_before": str(explained.mode_before),
            "mode_after": str(explained.mode_after),
            "occasion": str(explained.occasion),
            "reason": str(explained.reason),
            "tip_error_mm": 1e3 * self.tip_error(explained),
            "innovation": float(explained.innovation),
            "gate": float(explained.gate),
            "candidates": len(explained.candidates),
            "inliers": int(explained.inliers.sum()),
            "attempts": explained.attempt_reasons.tolist(),
        }

    def nearest(self, time: float) -> ExplainedVolume:
        """Return the kept volume nearest to a time in s, which must not lie outside all of them."""
        times = np.array([float(each.volume_time) for each in self.kept])
        if not times[0] - _TOLERANCE <= time <= times[-1] + _TOLERANCE:
            raise ConfigurationError(
                f"time: {time:g} s is outside; {self.folder} has explanations from "
                f"{times[0]:.2f} to {times[-1]:.2f} s "
                f"(list them: sonoservo explain {shlex.quote(str(self.folder))})"
            )
        return self.kept[int(np.abs(times - time).argmin())]

    def sheet(self, explained: ExplainedVolume) -> Figure:
        """Return the figure of a kept volume; see `plot_explanation`."""
        needle = imaged_needle(self.log, explained) if self.log is not None else None
        return plot_explanation(
            explained, kept=self.kept, needle=needle, tip_error=self.tip_error(explained)
        )


def read_explained_run(folder: Path) -> ExplainedRun:
    """Read the explained volumes of a run; a ConfigurationError says what to do without any."""
    make = f"sonoservo run SCENARIO --explain --out {shlex.quote(str(folder))}"
    if folder.is_file():
        source = shlex.quote(str(folder))
        raise ConfigurationError(
            f"{folder} is no folder of results; make one: sonoservo track {source} --explain"
        )
    if not folder.is_dir():
        raise ConfigurationError(f"there is no folder {folder}; make it: {make}")
    if not (folder / FOLDER).is_dir():
        scenario = folder / "scenario.yaml"
        if (folder / "estimates.csv").is_file():
            make = f"sonoservo track SOURCE --explain --out {shlex.quote(str(folder))}"
        elif scenario.is_file():
            make = f"sonoservo run {shlex.quote(str(scenario))} --explain"
        raise ConfigurationError(f"{folder} has no explanations; repeat the run: {make}")
    with refusing_values():
        kept = read_explanations(folder)
        log = read_log(folder / "log.npz", RunLog) if (folder / "log.npz").is_file() else None
    if not kept:
        raise ConfigurationError(
            f"{folder} was run with --explain, but nothing happened that was to be explained: "
            "the tracker never changed its mode and the tip was always near where it was expected"
        )
    return ExplainedRun(folder, kept, log)


def explanation_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the rows of an `ExplainedRun` as a table for a terminal."""
    table = Table("time, s", "what happened", "tip error, mm", "why it was not confirmed")
    table.columns[0].justify = table.columns[2].justify = "right"
    for row in rows:
        before, happened, error = row["mode_before"], row["mode_after"], row["tip_error_mm"]
        if before and before != happened:
            happened = f"{before} → {happened}"
        elif row["occasion"] not in (BEFORE, AFTER):
            happened = f"{happened}, {row['occasion']}"
        error_mm = f"{error:.1f}" if np.isfinite(error) else ""
        table.add_row(f"{row['time_s']:.2f}", happened, error_mm, row["reason"])
    return table
