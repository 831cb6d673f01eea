"""Table of the estimates in a recording: the rows of `estimates.csv`, in the file's coordinates."""

import csv
import io
from collections import Counter
from collections.abc import Sequence
from typing import Any, TextIO

import numpy as np

from sonoservo.diagrams.tracker_bench import Tracked
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.search_reason import Reader, ReasonCount


def estimate_row(tracked: Tracked, *, posed: bool) -> dict[str, Any]:
    """Return an estimate as a row of ``estimates.csv``, in the source's own frame L (LPS).

    Its place in the world is known only if the volume is ``posed``.
    """
    estimate, X_WL = tracked.estimate, tracked.X_WL
    row: dict[str, Any] = {
        "volume": tracked.number,
        "time_s": tracked.volume.time,
        "mode": str(estimate.mode),
        "estimate_time_s": estimate.time,
        "probability": estimate.probability,
    }
    entry = middle = tip = velocity = w_tip = np.full(3, np.nan)
    covariance = np.full((3, 3), np.nan)
    if estimate.curve is not None:
        X_LW = X_WL.inverse()
        entry, middle, tip = 1e3 * X_LW.multiply(estimate.curve.position([0, 0.5, 1]).T).T
        velocity = 1e3 * (X_LW.rotation() @ estimate.tip_velocity)
        w_tip = 1e3 * estimate.curve.tip if posed else w_tip
        R_LW = X_LW.rotation().matrix()
        covariance = 1e6 * R_LW @ estimate.tip_covariance @ R_LW.T
    direction = (tip - entry) / np.linalg.norm(tip - entry) if estimate else tip
    for name, vector, unit in (
        ("tip", tip, "mm"),
        ("entry", entry, "mm"),
        ("middle", middle, "mm"),
        ("direction", direction, ""),
        ("tip_velocity", velocity, "mm_s"),
    ):
        for axis, value in zip("lps", vector, strict=True):
            row["_".join(filter(None, (name, axis, unit)))] = float(value)
    for i, j in zip(*np.triu_indices(3), strict=True):
        row[f"tip_covariance_{'lps'[i]}{'lps'[j]}_mm2"] = float(covariance[i, j])
    for axis, value in zip("xyz", w_tip, strict=True):
        row[f"world_tip_{axis}_mm"] = float(value)
    row["reason"] = estimate.reason
    return row


_SINGLE = "find the needle in a single volume with sonoservo locate, or record more"


class ModeCount:
    """Sink that counts the tracker's modes, why volumes gave no needle, and where it was found."""

    def __init__(self, parameters: TrackerParameters | None) -> None:
        anywhere = getattr(parameters, "start", None) == "anywhere"
        self.reader = Reader.RECORDING_ANYWHERE if anywhere else Reader.RECORDING
        self._modes: Counter[str] = Counter()
        self._lost = ReasonCount()
        self._found_s: float | None = None
        self._tip_mm: list[float] | None = None

    def __call__(self, tracked: Tracked) -> None:
        """Count a volume."""
        estimate = tracked.estimate
        self._modes[str(estimate.mode)] += 1
        if estimate.mode == TrackingMode.TRACKING and estimate.curve is not None:
            self._found_s = tracked.volume.time if self._found_s is None else self._found_s
            self._tip_mm = (1e3 * tracked.X_WL.inverse().multiply(estimate.curve.tip)).tolist()
        if not estimate:
            self._lost.add(estimate.reason)

    def figures(self) -> dict[str, Any]:
        """Return the figures of a summary."""
        single = self._modes.total() == 1
        advice = _SINGLE if single else self._lost.advice(self.reader)
        return {
            "volumes": self._modes.total(),
            "modes": dict(sorted(self._modes.items())),
            "found_s": self._found_s,
            "last_tip_mm": self._tip_mm,
            "reasons": self._lost.words,
            "advice": "" if self._modes["tracking"] else advice,
        }


class EstimatesTable:
    """Writes rows as CSV, complete after every row; the cell of a missing number is empty."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._writer: csv.DictWriter[str] | None = None

    def append(self, row: dict[str, Any]) -> None:
        """Write a row; before the first one, the header."""
        if self._writer is None:
            self._writer = csv.DictWriter(self._stream, list(row), lineterminator="\n")
            self._writer.writeheader()
        self._writer.writerow(
            {k: "" if isinstance(v, float) and v != v else v for k, v in row.items()}
        )
        self._stream.flush()


def estimates_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Return rows as CSV, as `EstimatesTable` writes them."""
    text = io.StringIO()
    table = EstimatesTable(text)
    for row in rows:
        table.append(row)
    return text.getvalue()
