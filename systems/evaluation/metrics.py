"""Metrics of a run: detection, tracking, servo, force, guard, computing times, and what failed."""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.evaluation.run_errors import (
    Floats,
    Mask,
    at_times,
    consistency,
    estimate_errors,
    features,
    is_known,
    needle_speed,
)
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.success import TrackedVolumes, from_needle, run_outcome
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.search_reason import (
    LONGER,
    Reader,
    ReasonCount,
    Remedy,
    SearchReason,
    advice,
)

_REST_SPEED, _REST_WINDOW, _REST_TIME = 0.2e-3, 1.0, 3.0
"""Speed of the tip in W in m/s below which the needle is at rest; time in s over which it is
measured, which averages out the hand's tremor; and time in s from then on until samples count as at
rest, which excludes the probe's transient."""

_WELL_IN_VIEW = 15e-3
"""Length in view in m above which an untracked needle counts as lost. If the log does not hold it,
the length in the tissue is used."""

START_TOLERANCE = (
    10e-3  # distance from the needle beyond which a start of the tracker is false, in m
)
_NO_FORCE = 0.05  # force in N at and below which there is no contact
_SETTLING = 2.0  # time in s from the first contact until the force counts as settled

_APPROACH_TIME, _APPROACH_SPEED = 0.2, 1e-3
"""Time in s, and speed in m/s above which a probe without contact is on its way to the body."""

_NO_CONTACT = Remedy(
    "check that the arm reaches the body and that its joints move",
    "max_speed, joint limits and home posture in the arm's file; the phantom's place",
)
_OUTSIDE = (
    Remedy("push it in before the run ends", "hand.start, hand.pushes, duration"),
    Remedy("record until it is in the tissue", options=""),
)
_UNSEEN = Remedy("push it further or below the probe", "hand.pushes, hand.aim", "")


def summarize(
    log: RunLog, force_target: float | None = 2.0, reader: Reader = Reader.SCENARIO
) -> dict[str, Any]:
    """Summarise a run in blocks of figures for JSON, by name; a figure without a value is None.

    The controller aims at the force target in N; None if it changes. The advice is for the reader.
    """
    summary: dict[str, Any] = {
        "simulated_s": _number(log.time[-1] if len(log.time) else 0.0),
        "detection": detection(log, reader),
        "tracking": tracking(log),
        "servo": servo(log),
        "force": force(log, force_target),
        "guard": guard(log),
        "compute_ms": {
            name: {"median": _number(_median(1e3 * t)), "max": _number(_max(1e3 * t))}
            for name, t in sorted(log.compute.items())
        },
        "success": TrackedVolumes.of(log).figures(),
    }
    summary["success"]["outcome"] = run_outcome(summary).value
    return summary


def detection(log: RunLog, reader: Reader = Reader.SCENARIO) -> dict[str, Any]:
    """Summarise the detection: the first start of tracking that is not false.

    Returns `volume`, number of volumes before it; `inserted_mm`, `visible_mm`, true lengths then;
    `false_starts` in the whole run, farther than `START_TOLERANCE` from the needle or without one;
    `reason`, `advice`: why nothing was found, and what to change.
    """
    started, true = _starts(log)
    right = started[true]
    first = int(right[0]) if len(right) else None
    reason, remedies = missing_needle(log) if first is None else ("", ())
    if first is None and force(log)["touched"] is False:
        reason, remedies = "", [_NO_CONTACT, LONGER]

    def length_mm(lengths: Floats) -> float | None:
        if first is None:
            return None
        return _number(1e3 * at_times(log, lengths, log.volume_estimate_time[[first]])[0])

    return {
        "volume": first,
        "inserted_mm": length_mm(log.inserted_length),
        "visible_mm": length_mm(log.visible_length),
        "false_starts": int(np.sum(~true)),
        "reason": reason or None,
        "advice": _sentence(advice(remedies, reader)) or None,
    }


def tracking(log: RunLog) -> dict[str, Any]:
    """Summarise the accuracy of tracking from the detection on, while a needle is in the tissue.

    Returns numbers of `volumes`: all, `tracked` (confirmed by the volume), `estimated`, `lost`
    (untracked with more than 15 mm in view); `lost_events`, unless withdrawn meanwhile;
    `reasons` of volumes without an estimate; `absent_s`, `wrong_s`: time with an estimate but no
    needle, or more than `START_TOLERANCE` off; `absent_travel_mm` of the servo without a needle;
    `consistency`; and errors with median, p95 and max: `tip_error_mm` in W,
    `tip_error_in_probe_mm`, `tip_axial_error_mm`, `tip_lateral_error_mm`, `axis_error_deg`; and
    `tip_axial_bias_mm`, positive beyond the true tip.
    """
    judged = judged_volumes(log)
    time = _estimate_times(log)
    length = at_times(log, log.inserted_length, time)
    visible = at_times(log, log.visible_length, time)
    tracked = log.volume_estimate_mode == TrackingMode.TRACKING
    in_view = np.where(np.isfinite(visible), visible, length)
    lost = judged & ~tracked & (in_view > _WELL_IN_VIEW)

    errors, unknown = estimate_errors(log), ~is_known(log.volume_estimate_tip)
    followed = is_known(log.estimate_tip) & (log.estimate_mode != TrackingMode.LOST)
    absent = log.inserted_length == 0
    right = from_needle(log, log.time, log.estimate_tip) <= START_TOLERANCE
    judgeable = np.isfinite(log.inserted_length)
    speed = np.linalg.norm(log.planar_velocity[:, :2], axis=1)
    return {
        "volumes": int(np.sum(judged)),
        "tracked": int(np.sum(judged & tracked)),
        "estimated": int(np.sum(judged & np.isfinite(errors.tip))),
        "lost": int(np.sum(lost)),
        "lost_events": _losses(lost, in_view, length),
        "reasons": ReasonCount(compress(volume_reasons(log), unknown)).words,
        "absent_s": _seconds(followed & absent, log.time),
        "wrong_s": _seconds(followed & judgeable & ~right, log.time),
        "absent_travel_mm": 1e3 * _seconds(absent, log.time, np.nan_to_num(speed)),
        "tip_error_mm": spread(1e3 * errors.tip[judged]),
        "tip_error_in_probe_mm": spread(1e3 * errors.in_probe[judged]),
        "tip_axial_error_mm": spread(1e3 * np.abs(errors.axial[judged])),
        "tip_lateral_error_mm": spread(1e3 * errors.lateral[judged]),
        "tip_axial_bias_mm": _number(_mean(1e3 * errors.axial[judged])),
        "axis_error_deg": spread(np.degrees(errors.axis[judged])),
        "consistency": consistency(log, judged),
    }


def _losses(lost: Mask, in_view: Floats, length: Floats) -> int:
    """Return how often a needle became lost, unless it was withdrawn from the view meanwhile."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lost, [False]]).astype(int)))
    count = 0
    for start, stop in edges.reshape(-1, 2):
        gone = stop < len(lost) and in_view[stop] <= _WELL_IN_VIEW and length[stop] < length[start]
        count += not gone
    return count


def judged_volumes(log: RunLog) -> Mask:
    """Return a (v,) mask of the volumes since the detection with the needle in the tissue."""
    started, true = _starts(log)
    right = started[true]
    length = at_times(log, log.inserted_length, _estimate_times(log))
    after = np.arange(len(length)) >= (right[0] if len(right) else len(length))
    return after & (np.nan_to_num(length) > 0)


def servo(log: RunLog) -> dict[str, Any]:
    """Return the mean absolute errors of the visual features in P (Chatelain 2013, eq. 23)."""
    tracked = log.estimate_mode == TrackingMode.TRACKING
    moves = needle_speed(log, _REST_WINDOW) >= _REST_SPEED
    rest = at_rest(log)
    true = features(log.X_WP, log.needle_tip, log.needle_entry)
    estimated = features(log.measured_X_WP, log.estimate_tip, log.estimate_entry)
    return {
        "at_rest": _feature_errors(true, tracked & rest, log.time),
        "at_rest_estimated": _feature_errors(estimated, tracked & rest, log.time),
        "moving": _feature_errors(true, tracked & moves, log.time),
    }


def at_rest(log: RunLog) -> Mask:
    """Return an (n,) mask of the samples at which the needle has rested for 3 s."""
    moves = needle_speed(log, _REST_WINDOW) >= _REST_SPEED
    return _held(~moves & is_known(log.needle_tip), log.time, _REST_TIME)


def force(log: RunLog, target: float | None = None) -> dict[str, Any]:
    """Summarise the true contact force."""
    value = log.contact_force
    touching = value > _NO_FORCE
    if not touching.any():
        return {
            "touched": False if np.isfinite(value).any() and not _lands(log) else None,
            "mean_n": None, "rms_error_n": None, "max_n": _number(_max(value)),
            "contact_lost_s": None,
        }  # fmt: skip
    first = log.time[np.argmax(touching)]
    settled = value[log.time >= first + _SETTLING]
    error = settled - (np.nan if target is None else target)
    return {
        "touched": True,
        "mean_n": _number(_mean(settled)),
        "rms_error_n": _number(np.sqrt(_mean(error**2))),
        "max_n": _number(_max(value)),
        "contact_lost_s": _seconds(~touching & (log.time >= first), log.time),
    }


def _lands(log: RunLog) -> bool:
    """Return True if the probe moves towards the body at the end of a log."""
    last = log.time >= log.time[-1] - _APPROACH_TIME
    p, time = log.X_WP[last][:, :3, 3], log.time[last]
    moved = float((p[-1] - p[0]) @ log.X_WP[-1][:3, 1])
    return moved > _APPROACH_SPEED * float(time[-1] - time[0])


def guard(log: RunLog) -> dict[str, Any]:
    """Summarise the interventions of the guard, and the volumes refused before the tracker."""
    stopped = log.guard_reason != ""
    refusals = log.refusal_reason[log.refusal_reason != ""]
    return {
        "interventions": int(np.sum(_begins(stopped))),
        "stopped_s": _seconds(stopped, log.time),
        "reasons": "; ".join(dict.fromkeys(log.guard_reason[stopped].tolist())) or None,
        "stopped_at_end": str(log.guard_reason[-1]) if stopped[-1:].any() else None,
        "volumes_refused": int(np.nan_to_num(_max(log.volumes_refused))),
        "refusal": str(refusals[-1]) if len(refusals) else None,
    }


def _estimate_times(log: RunLog) -> Floats:
    """Return the (v,) times for which the estimates hold, or else of the volumes, in s."""
    known = np.isfinite(log.volume_estimate_time)
    return np.where(known, log.volume_estimate_time, log.volume_time)


def _starts(log: RunLog) -> tuple[NDArray[np.intp], Mask]:
    """Return the volumes with which tracking began, and a mask of those that are not false."""
    followed = log.volume_estimate_mode != TrackingMode.LOST
    started = np.flatnonzero(_begins(is_known(log.volume_estimate_tip) & followed))
    time, p = log.volume_estimate_time[started], log.volume_estimate_tip[started]
    return started, from_needle(log, time, p) <= START_TOLERANCE


def _begins(condition: Mask) -> Mask:
    """Return an (m,) mask of the samples at which a condition begins to hold."""
    return condition & ~np.concatenate([np.zeros(1, bool), condition])[:-1]


def _held(condition: Mask, time: Floats, duration: float) -> Mask:
    """Return an (m,) mask of the samples at which a condition has held for a duration in s."""
    broken = np.where(condition, -np.inf, time)
    since = np.maximum.accumulate(broken) if len(time) else broken
    since = np.maximum(since, time[0]) if len(time) else since
    return condition & (time - since >= duration)


def _feature_errors(errors: Floats, counted: Mask, time: Floats) -> dict[str, float | None]:
    counted = counted & is_known(errors)
    if not counted.any():
        return {"x_mm": None, "z_mm": None, "theta_deg": None, "seconds": 0.0}
    x, z, theta = np.abs(errors[counted]).mean(axis=0)
    return {
        "x_mm": _number(1e3 * x),
        "z_mm": _number(1e3 * z),
        "theta_deg": _number(np.degrees(theta)),
        "seconds": _seconds(counted, time),
    }


def _seconds(counted: Mask, time: Floats, weights: Floats | float = 1.0) -> float:
    """Return the time that samples cover, or the integral of their weights over it."""
    steps = np.diff(time, append=time[-1:])
    return float((steps * weights)[counted].sum())


def spread(values: Floats) -> dict[str, float | None]:
    """Return the median, 95th percentile and maximum of the finite values; None without any."""
    values = values[np.isfinite(values)]
    p95 = np.percentile(values, 95) if len(values) else np.nan
    return {"median": _number(_median(values)), "p95": _number(p95), "max": _number(_max(values))}


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _reduced(function: Callable[[Floats], Any], values: Floats) -> float:
    """Return a statistic of the finite values; NaN without any."""
    values = values[np.isfinite(values)]
    return float(function(values)) if len(values) else np.nan


_mean, _median, _max = (partial(_reduced, each) for each in (np.mean, np.median, np.max))


_IN_VIEW = 5e-3
"""Length of the needle in the swept sector, in m, from which the tracker could find it."""


def missing_needle(log: RunLog) -> tuple[str, Sequence[Remedy]]:
    """Return why the tracker found no needle, as a sentence or empty, and what to change."""
    reasons = volume_reasons(log)
    if not reasons:
        return "No volume was acquired.", SearchReason.NO_VOLUME.remedies
    last = f" {_sentence(reasons[-1])}" if reasons[-1] else ""
    if np.nanmax(log.inserted_length, initial=-1) == 0:
        return f"The needle stayed outside the tissue.{last}", _OUTSIDE
    visible = at_times(log, log.visible_length, log.volume_time)
    seen = np.nan_to_num(visible) > _IN_VIEW
    if np.isfinite(visible).any() and not seen.any():
        stopped = guard(log)["stopped_s"]
        held = f" The guard had stopped the robot for {stopped:.1f} s." if stopped else ""
        return f"The needle never came into view.{held}{last}", [_UNSEEN]
    shown = [reason for reason, each in zip(reasons, seen, strict=True) if each] or reasons
    # The first volumes have nothing to be compared with, whatever else is wrong.
    early = SearchReason.NOTHING_EARLIER
    shown = [each for each in shown if SearchReason.of(each) is not early] or shown
    counts = Counter(SearchReason.of(each) or each for each in shown)
    usual, _ = counts.most_common(1)[0]
    last = next(each for each in reversed(shown) if (SearchReason.of(each) or each) == usual)
    return _sentence(last), usual.remedies if isinstance(usual, SearchReason) else ()


def volume_reasons(log: RunLog) -> list[str]:
    """Return for each volume of a log why it gave no needle; empty if nothing was said."""
    given = log.volume_detected, log.volume_detection_reason, log.volume_measurement_reason
    return [_reason(*each) for each in zip(*(column.tolist() for column in given), strict=True)]


def _reason(is_detected: bool, detection: str, measurement: str) -> str:
    """Return the reason of one volume, from those of the detector and the localizer."""
    measured, detected = SearchReason.of(measurement), SearchReason.of(detection)
    if is_detected and measured is SearchReason.NOT_DETECTED:
        return SearchReason.MOTION_UNCONFIRMED("; the needle is not confirmed yet")
    nothing_said = not detection or detected is SearchReason.TRACKED
    return measurement if nothing_said else detection


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}." if text else ""
