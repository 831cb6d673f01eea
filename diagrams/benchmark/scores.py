"""Scores of a tracker: what became of its sequences, and figures with intervals over them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.diagrams.benchmark.estimates import Estimated, log_of_estimates
from sonoservo.diagrams.studies.robustness.runs import as_in_probe
from sonoservo.diagrams.studies.robustness.stated_doubt import inside_stated
from sonoservo.systems.evaluation.intervals import (
    Interval,
    count_interval,
    proportion_interval,
    run_interval,
)
from sonoservo.systems.evaluation.metrics import MetricsParameters, detection
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

    Errors are those in the probe's frame, so that errors of the measured pose itself do not count.
    While the probe is lifted there is no needle to be seen.

    Parameters
    ----------
    truth, lifted
        Truth of the sequence, and the times in s of its forced loss.
    volumes
        Time in s and measured pose of each volume.
    rows
        Estimates of the tracker.

    Returns
    -------
    `tip_mm`, `axis_deg`: errors of the volumes with enough of the needle to be seen, None where the
    right one is not tracked; `found`; `delay_s`, from the first such volume to the first in which
    it is tracked; `kept`, the volumes from then on, right or not; `false_finds`; `seconds`;
    `reacquired`, None if there was nothing to lose; `stated`, pairs of a stated probability and
    whether there was the needle; `inside`, whether the tip lay inside the stated 95 %; `process_ms`
    of each volume; `worst`, the number of the volume with the largest error.
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
    near_needle = np.nan_to_num(near, nan=np.inf) <= MetricsParameters().start_tolerance
    given = [(n, by_volume[n]) for n in range(len(time)) if by_volume.get(n)]
    inside = inside_stated(log)["tip"]
    first = np.flatnonzero(seen)
    return {
        "tip_mm": _plain(errors),
        "axis_deg": _plain(np.where(right, judged.axis, np.inf)[seen]),
        "found": judged.found if len(first) else None,
        "delay_s": float(time[np.argmax(right)] - time[first[0]])
        if len(first) and judged.found
        else None,
        "kept": right[judged.judged].tolist(),
        "false_finds": detection(log, MetricsParameters())["false_starts"],
        "seconds": float(truth.time[-1]),
        "reacquired": bool((right & (time >= lifted[1])).any()) if before.any() else None,
        "stated": [
            [each.probability, bool(near_needle[n])]
            for n, each in given
            if each.probability is not None
        ],
        "inside": [inside[n] for n, each in given
                   if inside[n] is not None and each.mode == TrackingMode.TRACKING],
        "process_ms": [each.process_ms for _, each in sorted(by_volume.items())
                       if each.process_ms is not None],
        "worst": int(first[np.argmax(errors)]) if len(first) else len(time) // 2,
    }  # fmt: skip


def _plain(errors: Floats) -> list[float | None]:
    return [float(each) if np.isfinite(each) else None for each in errors]


@dataclass(frozen=True)
class Score:
    """A figure with its 95 % interval; None is a figure that nothing tells, or an infinite one.

    Parameters
    ----------
    value, low, high
        Figure and ends of its interval.
    text
        What a table shows.
    """

    value: float | None
    low: float | None
    high: float | None
    text: str

    def plain(self) -> dict[str, Any]:
        """Return the figure in types that JSON has."""
        return {"value": self.value, "low": self.low, "high": self.high, "text": self.text}


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


def score(records: Sequence[Mapping[str, Any]]) -> dict[str, Score]:
    """Return the `FIGURES` of a tracker's records in some sequences; see `judge_sequence`."""
    hours = sum(each["seconds"] for each in records) / 3600
    false = sum(each["false_finds"] for each in records)
    rate = Interval(*(end / hours for end in count_interval(false))) if hours else Interval(0, 0)

    def values(name: str) -> list[Floats]:
        found = [np.array(each[name], float) for each in records]
        return [np.where(np.isnan(each), np.inf, each) for each in found if len(each)]

    delays = [
        np.array([np.inf if each["delay_s"] is None else each["delay_s"]])
        for each in records
        if each["found"] is not None
    ]
    return {
        "found": _share([each["found"] for each in records]),
        "kept": _figure(values("kept"), np.mean, 100),
        "false_finds_per_hour": Score(
            false / hours if hours else None, rate.low, rate.high,
            f"{false / hours:.0f} ({rate.high:.0f})" if hours else "–",
        ),
        "reacquired": _share([each["reacquired"] for each in records]),
        "tip_mm": _figure(values("tip_mm"), _quantile(0.5)),
        "tip_p95_mm": _figure(values("tip_mm"), _quantile(0.95)),
        "axis_deg": _figure(values("axis_deg"), _quantile(0.5)),
        "delay_s": _figure(delays, _quantile(0.5)),
        "inside": _figure(values("inside"), np.mean, 100),
        "process_ms": _figure(values("process_ms"), _quantile(0.5)),
    }  # fmt: skip


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


def _quantile(share: float) -> Callable[[Floats], float]:
    """Return a statistic that takes a value that was seen, so that infinite ones are allowed."""
    return lambda values: float(np.quantile(values, share, method="inverted_cdf"))


def _share(outcomes: Sequence[bool | None]) -> Score:
    counted = [each for each in outcomes if each is not None]
    if not counted:
        return Score(None, None, None, "–")
    right = sum(counted)
    low, high = proportion_interval(right, len(counted))
    return Score(right / len(counted), low, high, f"{right} of {len(counted)}")


def _figure(
    runs: Sequence[Floats], statistic: Callable[[Floats], float], scale: float = 1.0
) -> Score:
    if not runs:
        return Score(None, None, None, "–")
    value = scale * float(statistic(np.concatenate(runs)))
    low, high = (scale * end for end in run_interval(runs, statistic))
    text = _digits(value)
    if np.isfinite(low) or np.isfinite(high):
        text += f" ({_digits(low)} to {_digits(high)})"
    return Score(_known(value), _known(low), _known(high), text)


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _digits(value: float) -> str:
    return "∞" if np.isinf(value) else f"{value:.3g}"
