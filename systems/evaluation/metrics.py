"""Figures that sum up a run: the blocks `detection`, `tracking`, `servo`, `force`, `compute_ms`."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.evaluation.run_errors import (
    Floats,
    Mask,
    at_times,
    estimate_errors,
    features,
    is_known,
    needle_speed,
)
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.requirements import require_not_negative, require_positive

LABELS = {
    "detection.volume": "insertion detected at volume",
    "detection.visible_mm": "needle in view at detection, mm",
    "detection.false_starts": "false starts in the whole run",
    "tracking.volumes": "volumes since then, with the needle in the tissue",
    "tracking.tracked": "of these, needle tracked",
    "tracking.lost_events": "times lost",
    "tracking.tip_error_mm.median": "tip error, median, mm",
    "tracking.tip_error_mm.p95": "tip error, 95 %, mm",
    "tracking.axis_error_deg.median": "axis error, median, deg",
    "tracking.axis_error_deg.p95": "axis error, 95 %, deg",
    "servo.at_rest.x_mm": "at rest: mean |X|, true, mm",
    "servo.at_rest.z_mm": "at rest: mean |Z|, true, mm",
    "servo.at_rest.theta_deg": "at rest: mean |Theta|, true, deg",
    "servo.at_rest_estimated.x_mm": "at rest: mean |X|, estimated, mm",
    "servo.at_rest_estimated.z_mm": "at rest: mean |Z|, estimated, mm",
    "servo.at_rest_estimated.theta_deg": "at rest: mean |Theta|, estimated, deg",
    "force.mean_n": "contact force, mean, N",
    "force.rms_error_n": "contact force, RMS error, N",
    "force.max_n": "contact force, largest, N",
    "compute_ms.render.median": "rendering a sweep, median, ms",
    "compute_ms.convert.median": "scan conversion, median, ms",
    "compute_ms.track.median": "tracking, median, ms",
    "real_time_factor": "simulated time / wall time",
}
"""Label of each figure of a summary that a table shows, by its dotted path."""


@dataclass(kw_only=True)
class MetricsParameters:
    """Thresholds of the metrics.

    Parameters
    ----------
    rest_speed
        The needle rests while its tip moves more slowly than this in W, in m/s.
    rest_window
        Time over which that speed is measured, so that a hand's tremor does not count, in s.
    rest_time
        At rest counts from this long after the needle came to rest, in s: the probe's transient
        is left out.
    min_length
        A needle with less than this in view may be missed without counting as lost, in m; in the
        tissue, where the log does not tell what is in view.
    start_tolerance
        A tracker that starts further than this from the needle has started falsely, in m.
    force_target
        Force that the controller aims at, in N; None if it changes.
    contact_threshold
        Force below which there is no contact, in N.
    settling_time
        The force counts as settled from this long after the first contact, in s.
    """

    rest_speed: float = 0.2e-3
    rest_window: float = 1.0
    rest_time: float = 3.0
    min_length: float = 15e-3
    start_tolerance: float = 10e-3
    force_target: float | None = 2.0
    contact_threshold: float = 0.05
    settling_time: float = 2.0

    def __post_init__(self) -> None:
        require_positive(
            rest_speed=self.rest_speed,
            rest_window=self.rest_window,
            start_tolerance=self.start_tolerance,
        )
        require_not_negative(
            rest_time=self.rest_time,
            min_length=self.min_length,
            force_target=self.force_target or 0.0,
            contact_threshold=self.contact_threshold,
            settling_time=self.settling_time,
        )


def summarize(log: RunLog, parameters: MetricsParameters | None = None) -> dict[str, Any]:
    """Sum up a run in numbers that JSON can hold; None where there is none.

    Returns
    -------
    Blocks by name; each function of this module makes one and says what is in it.
    """
    parameters = parameters or MetricsParameters()
    return {
        "simulated_s": _number(log.time[-1] if len(log.time) else 0.0),
        "detection": detection(log, parameters),
        "tracking": tracking(log, parameters),
        "servo": servo(log, parameters),
        "force": force(log, parameters),
        "compute_ms": {
            name: {"median": _number(_median(1e3 * t)), "max": _number(_max(1e3 * t))}
            for name, t in sorted(log.compute.items())
        },
    }


def detection(log: RunLog, parameters: MetricsParameters) -> dict[str, Any]:
    """Sum up when the tracker found the needle.

    Returns
    -------
    `volume`: how many volumes came before the one with which tracking began;
    `inserted_mm`, `visible_mm`: true length inside the tissue, and inside the swept sector, when it
    began;
    `false_starts`: how often tracking began with a tip more than `start_tolerance` away from the
    true needle, or without any needle. The detection is the first start that is not false.
    """
    started, true = _starts(log, parameters)
    right = started[true]
    first = int(right[0]) if len(right) else None

    def length_mm(lengths: Floats) -> float | None:
        if first is None:
            return None
        return _number(1e3 * at_times(log, lengths, log.volume_estimate_time[[first]])[0])

    return {
        "volume": first,
        "inserted_mm": length_mm(log.inserted_length),
        "visible_mm": length_mm(log.visible_length),
        "false_starts": int(np.sum(~true)),
    }


def tracking(log: RunLog, parameters: MetricsParameters) -> dict[str, Any]:
    """Sum up how well the needle was followed, over all volumes from the detection on.

    Only volumes while there is a needle in the tissue are judged; failures stay in. Truth is
    interpolated at the time for which the estimate holds.

    Returns
    -------
    `volumes`: judged; `tracked`: of these, confirmed by the volume itself (mode tracking);
    `estimated`: of these, with any estimate, which is what the errors are taken over;
    `lost`: volumes that were not tracked with more than `min_length` of needle in view;
    `lost_events`: how often that began;
    `tip_error_mm`: distance from the estimated to the true tip; `tip_axial_error_mm` and
    `tip_lateral_error_mm`: its parts along and across the true needle;
    `axis_error_deg`: angle between the estimated and the true direction (`EstimateErrors`);
    each {median, p95, max}; `tip_axial_bias_mm`: mean of the signed axial part, above zero where
    the estimate lies beyond the true tip.
    """
    started, true = _starts(log, parameters)
    right = started[true]
    time = np.where(
        np.isfinite(log.volume_estimate_time), log.volume_estimate_time, log.volume_time
    )
    length = at_times(log, log.inserted_length, time)
    visible = at_times(log, log.visible_length, time)
    judged = np.nan_to_num(length) > 0
    judged &= np.arange(len(time)) >= (right[0] if len(right) else len(time))
    tracked = log.volume_estimate_mode == TrackingMode.TRACKING
    in_view = np.where(np.isfinite(visible), visible, length)
    lost = judged & ~tracked & (in_view > parameters.min_length)

    errors = estimate_errors(log)
    return {
        "volumes": int(np.sum(judged)),
        "tracked": int(np.sum(judged & tracked)),
        "estimated": int(np.sum(judged & np.isfinite(errors.tip))),
        "lost": int(np.sum(lost)),
        "lost_events": int(np.sum(_begins(lost))),
        "tip_error_mm": spread(1e3 * errors.tip[judged]),
        "tip_axial_error_mm": spread(1e3 * np.abs(errors.axial[judged])),
        "tip_lateral_error_mm": spread(1e3 * errors.lateral[judged]),
        "tip_axial_bias_mm": _number(_mean(1e3 * errors.axial[judged])),
        "axis_error_deg": spread(np.degrees(errors.axis[judged])),
    }


def servo(log: RunLog, parameters: MetricsParameters) -> dict[str, Any]:
    """Mean absolute errors of the visual features in P (Chatelain 2013, eq. 23).

    Returns
    -------
    `at_rest`: of the true needle, while it has rested in W for `rest_time` and is tracked;
    `at_rest_estimated`: of the estimate, over the same samples;
    `moving`: of the true needle, while it moves and is tracked.
    Each {x_mm, z_mm, theta_deg, seconds}; `seconds` says how much of the run it covers.
    """
    tracked = log.estimate_mode == TrackingMode.TRACKING
    moves = needle_speed(log, parameters.rest_window) >= parameters.rest_speed
    rest = _held(~moves & is_known(log.needle_tip), log.time, parameters.rest_time)
    true = features(log.X_WP, log.needle_tip, log.needle_entry)
    estimated = features(log.X_WP, log.estimate_tip, log.estimate_entry)
    return {
        "at_rest": _feature_errors(true, tracked & rest, log.time),
        "at_rest_estimated": _feature_errors(estimated, tracked & rest, log.time),
        "moving": _feature_errors(true, tracked & moves, log.time),
    }


def force(log: RunLog, parameters: MetricsParameters) -> dict[str, Any]:
    """Sum up the true contact force.

    Returns
    -------
    `mean_n`, `rms_error_n`: mean, and root of the mean squared difference to `force_target` (none
    where it changes), from `settling_time` after the first contact on; `max_n`: largest of the
    whole run (between samples it may have been higher); `contact_lost_s`: time without contact
    after the first contact.
    """
    value = log.contact_force
    touching = value > parameters.contact_threshold
    if not touching.any():
        return {
            "mean_n": None, "rms_error_n": None, "max_n": _number(_max(value)),
            "contact_lost_s": None,
        }  # fmt: skip
    first = log.time[np.argmax(touching)]
    settled = value[log.time >= first + parameters.settling_time]
    target = parameters.force_target
    error = settled - (np.nan if target is None else target)
    return {
        "mean_n": _number(_mean(settled)),
        "rms_error_n": _number(np.sqrt(_mean(error**2))),
        "max_n": _number(_max(value)),
        "contact_lost_s": _seconds(~touching & (log.time >= first), log.time),
    }


def _starts(log: RunLog, parameters: MetricsParameters) -> tuple[NDArray[np.intp], Mask]:
    """Volumes with which tracking began, and whether the needle was there."""
    there = is_known(log.volume_estimate_tip)
    started = np.flatnonzero(_begins(there))
    time, p = log.volume_estimate_time[started], log.volume_estimate_tip[started]
    tip, entry = at_times(log, log.needle_tip, time), at_times(log, log.needle_entry, time)
    along = np.sum((p - entry) * (tip - entry), axis=1)
    squared = np.sum((tip - entry) ** 2, axis=1)
    u = np.clip(along / np.where(squared > 0, squared, 1.0), 0, 1)[:, np.newaxis]
    distance = np.linalg.norm(p - (entry + u * (tip - entry)), axis=1)
    return started, distance <= parameters.start_tolerance


def _begins(condition: Mask) -> Mask:
    """(m,) whether a condition holds and did not hold one before."""
    return condition & ~np.concatenate([np.zeros(1, bool), condition])[:-1]


def _held(condition: Mask, time: Floats, duration: float) -> Mask:
    """Whether a condition has held for a duration."""
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


def _seconds(counted: Mask, time: Floats) -> float:
    steps = np.diff(time, append=time[-1:])
    return float(steps[counted].sum())


def spread(values: Floats) -> dict[str, float | None]:
    """Return the median, the 95th percentile and the maximum of what is finite; None for none."""
    values = values[np.isfinite(values)]
    p95 = np.percentile(values, 95) if len(values) else np.nan
    return {
        "median": _number(_median(values)),
        "p95": _number(p95),
        "max": _number(_max(values)),
    }


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None


def _finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _mean(values: Floats) -> float:
    values = _finite(values)
    return float(values.mean()) if len(values) else np.nan


def _median(values: Floats) -> float:
    values = _finite(values)
    return float(np.median(values)) if len(values) else np.nan


def _max(values: Floats) -> float:
    values = _finite(values)
    return float(values.max()) if len(values) else np.nan
