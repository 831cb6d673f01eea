"""Readings of the console: the state in words, and the values of its strips."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.control.visual_features import needle_features
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.search_reason import SearchReason

Floats = NDArray[np.float64]

_NONE = math.nan
_WAITING = "waiting for the first volume (kernels are compiled once, up to a minute)"


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Values of the strips at one time; NaN where there is none.

    Parameters
    ----------
    time
        Time in s.
    mode
        Tracking mode in a word; empty without a tracker.
    x, z, theta
        Features of the estimated needle that the visual servo drives to zero, in mm, mm and deg.
    depth
        Depth of the estimated tip below the middle of the probe's face, in mm.
    force, target
        Contact force and its target, in N.
    error
        Distance of the estimated tip from the true one, in mm.
    reason, held, stopped
        Why the tracker did not confirm the needle, why the servo holds, and why the guard has
        stopped the robot; empty if there is nothing to say.
    """

    time: float
    mode: str = ""
    x: float = _NONE
    z: float = _NONE
    theta: float = _NONE
    depth: float = _NONE
    force: float = _NONE
    target: float = _NONE
    error: float = _NONE
    reason: str = ""
    held: str = ""
    stopped: str = ""


def sample_estimate(
    time: float, estimate: NeedleEstimate | None, X_WP: RigidTransform, **values: Any
) -> Sample:
    """Return a sample with the features of an estimate, seen from the probe.

    Parameters
    ----------
    time
        Time of the sample, in s.
    estimate
        Estimate of the needle; None without a tracker.
    X_WP
        Pose of the probe.
    values
        Further fields of the `Sample`.
    """
    if estimate is None:
        return Sample(time=time, **values)
    seen = estimate.volume_time > -math.inf
    values |= {"mode": str(estimate.mode), "reason": estimate.reason if seen else _WAITING}
    if estimate.curve is None:
        return Sample(time=time, **values)
    entry, tip = X_WP.inverse().multiply(np.stack([estimate.curve.entry, estimate.curve.tip]).T).T
    x, z, theta = needle_features(tip, tip - entry).tolist()
    return Sample(
        time=time, x=1e3 * x, z=1e3 * z, theta=math.degrees(theta), depth=1e3 * float(tip[1]),
        **values,
    )  # fmt: skip


def tip_error(estimate: NeedleEstimate, tips: Sequence[tuple[float, Floats]]) -> float:
    """Return the distance in mm of an estimated tip from the true one; NaN if either is unknown.

    Parameters
    ----------
    estimate
        Estimate of the needle.
    tips
        Recent times in s, and true positions of the tip in W, in m. They are compared at the time
        for which the estimate holds.
    """
    if estimate.curve is None or not tips or estimate.time < tips[0][0]:
        return _NONE
    times, positions = zip(*tips, strict=True)
    true = [np.interp(estimate.time, times, axis) for axis in np.array(positions).T]
    return 1e3 * float(np.linalg.norm(estimate.curve.tip - true))


def shown_number(value: float) -> float | None:
    """Return a number for a page, which shows thousandths; None if it is not finite."""
    return round(value, 3) if math.isfinite(value) else None


def describe_state(sample: Sample | None) -> dict[str, str]:
    """Return the state in words.

    Parameters
    ----------
    sample
        Newest sample, if any.

    Returns
    -------
    ``kind`` (stopped, or the mode, or waiting), ``word`` to show large, ``detail`` with the reason,
    and ``advice`` on what a user can change.
    """
    if sample is None:
        return {"kind": "waiting", "word": "waiting", "detail": _WAITING, "advice": ""}
    if sample.stopped:
        return {
            "kind": "stopped", "word": "stopped by the guard", "detail": sample.stopped,
            "advice": "",
        }  # fmt: skip
    if not sample.mode:
        word = sample.reason or "showing"
        return {"kind": "showing", "word": word, "detail": "", "advice": ""}
    kind, detail = sample.mode, sample.reason
    advice = ""
    if kind == "searching" and detail != _WAITING:
        reason = SearchReason.of(detail)
        if reason is not None:
            detail, advice = reason.words, reason.run_advice
    return {"kind": kind, "word": kind, "detail": detail, "advice": advice}
