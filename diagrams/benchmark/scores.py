"""Scores of a tracker: the record of each sequence, and figures with intervals over them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.diagrams.benchmark.estimates import Estimated, log_of_estimates
from sonoservo.diagrams.studies.robustness.runs import as_in_probe
from sonoservo.diagrams.studies.run_group import RunGroup, Value, pooled, quantile_of
from sonoservo.diagrams.studies.study_report import figure_text
from sonoservo.systems.evaluation.intervals import count_interval, proportion_interval
from sonoservo.systems.evaluation.metrics import START_TOLERANCE, detection
from sonoservo.systems.evaluation.run_errors import inside_stated
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.success import ENOUGH_MM, TrackedVolumes, from_needle
from sonoservo.systems.signals.needle_estimate import TrackingMode

Floats = NDArray[np.float64]

BINS = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
"""Limits of the stated probabilities that make a point of the reliability curve."""

_JUST_BEFORE = 1.5
"""Time in s before the forced loss in which a tracker must have had the needle to lose it."""


def judge_sequence(
    truth: RunLog,
    volumes: Sequence[tuple[float, RigidTransform]],
    lifted: tuple[float, float],
    rows: Sequence[Estimated],
) -> dict[str, Any]:
    """Return the record of a tracker in a sequence, in types that JSON has.

    Errors, in the probe's frame, are infinite (None) where the right needle is not tracked. While
    the probe is lifted there is no needle to be seen.
    """
    log = as_in_probe(log_of_estimates(truth, volumes, rows))
    judged = TrackedVolumes.of(log)
    time = log.volume_time
    off = (time > lifted[0]) & (time < lifted[1])
    judged = replace(judged, to_be_seen=np.where(off, 0.0, judged.to_be_seen))
    seen, right = judged.to_be_seen >= ENOUGH_MM, judged.right
    errors = np.where(right, judged.tip, np.inf)[seen]
    before = right & (time < lifted[0]) & (time > lifted[0] - _JUST_BEFORE)
    by_volume = {each.volume: each for each in rows}
    near = from_needle(log, log.volume_estimate_time, log.volume_estimate_tip)
    near_needle = np.nan_to_num(near, nan=np.inf) <= START_TOLERANCE
    given = [(n, by_volume[n]) for n in range(len(time)) if by_volume.get(n)]
    inside = inside_stated(log)["tip"]
    first = np.flatnonzero(seen)
    return {
        # Of the volumes with enough to be seen.
        "tip_mm": _plain(errors),
        "axis_deg": _plain(np.where(right, judged.axis, np.inf)[seen]),
        "found": judged.found if len(first) else None,
        # From the first such volume to the detection.
        "delay_s": float(time[np.argmax(right)] - time[first[0]])
        if len(first) and judged.found
        else None,
        # Whether it is the right needle, from the detection on.
        "kept": right[judged.judged].tolist(),
        "false_finds": detection(log)["false_starts"],
        "seconds": float(truth.time[-1]),
        "reacquired": bool((right & (time >= lifted[1])).any()) if before.any() else None,
        # Pairs of a stated probability and whether there was the needle.
        "stated": [
            [each.probability, bool(near_needle[n])]
            for n, each in given
            if each.probability is not None
        ],
        "inside": [inside[n] for n, each in given
                   if inside[n] is not None and each.mode == TrackingMode.TRACKING],
        "process_ms": [each.process_ms for _, each in sorted(by_volume.items())
                       if each.process_ms is not None],
        # Number of the volume with the largest error.
        "worst": int(first[np.argmax(errors)]) if len(first) else len(time) // 2,
    }  # fmt: skip


def _plain(errors: Floats) -> list[float | None]:
    return [float(each) if np.isfinite(each) else None for each in errors]


FIGURES: Mapping[str, str] = {
    "found": "found",
    "kept": "kept (%)",
    "false_finds_per_hour": "false finds an hour, at most (95 %)",
    "reacquired": "re-acquired after the loss",
    "tip_mm": "tip, median (mm)",
    "tip_p95_mm": "tip, 95 % (mm)",
    "axis_deg": "axis, median (deg)",
    "delay_s": "delay (s)",
    "inside": "in the stated 95 % (%)",
    "process_ms": "processor (ms a volume)",
}
"""Heads of a table of scores by figure; an error of what is not tracked is infinite."""


def score(records: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the `FIGURES` of a tracker's records in some sequences (`judge_sequence`).

    Each has `value`, `low`, `high` (None if nothing tells it, or it is infinite) and `text`.
    """
    hours = sum(each["seconds"] for each in records) / 3600
    false = sum(each["false_finds"] for each in records)
    rate = [each / hours for each in (false, *count_interval(false))] if hours else 3 * [None]

    def values(name: str) -> list[Floats]:
        found = [np.array(each[name], float) for each in records]
        return [np.where(np.isnan(each), np.inf, each) for each in found if len(each)]

    def figure(name: str, statistic: Callable[[Floats], float]) -> dict[str, Any]:
        return _figure(pooled(values(name), statistic))

    delays = [
        np.array([np.inf if each["delay_s"] is None else each["delay_s"]])
        for each in records
        if each["found"] is not None
    ]
    return {
        "found": _share(records, "found"),
        "kept": figure("kept", _percent),
        "false_finds_per_hour": _plain_figure(
            rate, f"{rate[0]:.0f} ({rate[2]:.0f})" if hours else "–"
        ),
        "reacquired": _share(records, "reacquired"),
        "tip_mm": figure("tip_mm", quantile_of(0.5)),
        "tip_p95_mm": figure("tip_mm", quantile_of(0.95)),
        "axis_deg": figure("axis_deg", quantile_of(0.5)),
        "delay_s": _figure(pooled(delays, quantile_of(0.5))),
        "inside": figure("inside", _percent),
        "process_ms": figure("process_ms", quantile_of(0.5)),
    }


def reliability(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the points of the reliability curve: stated probability, share of needles, number.

    Each point has the interval of its share. It treats the volumes of a sequence as independent,
    so it is too narrow; whole sequences would have to be resampled for few points.
    """
    stated = [tuple(pair) for each in records for pair in each["stated"]]
    points = []
    for low, high in pairwise(BINS):
        here = [each for each in stated if low <= each[0] < high or each[0] == high == 1]
        if not here:
            continue
        right = sum(each[1] for each in here)
        ends = proportion_interval(right, len(here))
        points.append({
            "from": low, "to": high, "stated": float(np.mean([each[0] for each in here])),
            "share": right / len(here), "low": ends.low, "high": ends.high, "volumes": len(here),
        })  # fmt: skip
    return points


def _percent(values: Floats) -> float:
    return 100 * float(np.mean(values))


def _share(records: Sequence[Mapping[str, Any]], name: str) -> dict[str, Any]:
    counted = [each[name] for each in records if each[name] is not None]
    share = RunGroup(counted, len(counted)).share(bool)
    ends = [None if each is None else each / 100 for each in (share.true, share.low, share.high)]
    return _plain_figure(ends, f"{sum(counted)} of {len(counted)}" if counted else "–")


def _figure(value: Value) -> dict[str, Any]:
    figures = value.true, value.low, value.high
    return _plain_figure(figures, figure_text(*figures))


def _plain_figure(figures: Sequence[float | None], text: str) -> dict[str, Any]:
    known = [None if each is None or not np.isfinite(each) else each for each in figures]
    return {**dict(zip(("value", "low", "high"), known, strict=True)), "text": text}
