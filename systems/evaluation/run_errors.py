"""Errors of a run over time, against ground truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.distance import cdist

from sonoservo.systems.control.visual_features import needle_features
from sonoservo.systems.evaluation.run_log import RunLog, unit
from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.sweep import SweepGeometry

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_WINDOW = 0.3
"""Time in s over which the tip's true velocity is taken; it averages out the hand's tremor."""


def features(X_WP: ArrayLike, p_WTip: ArrayLike, p_WEntry: ArrayLike) -> Floats:
    """Return (n, 3) features x, z in m and theta in rad of needles in W; NaN for an unknown one."""
    X_WP, p_WTip = np.asarray(X_WP), np.asarray(p_WTip)
    R_PW = np.swapaxes(X_WP[:, :3, :3], 1, 2)
    tip = np.einsum("nij,nj->ni", R_PW, p_WTip - X_WP[:, :3, 3])
    k = np.einsum("nij,nj->ni", R_PW, p_WTip - np.asarray(p_WEntry))
    each = [needle_features(*needle) for needle in zip(tip, k, strict=True)]
    return np.array(each, dtype=float).reshape(-1, 3)


def needle_speed(log: RunLog, window: float) -> Floats:
    """Return the (n,) speed of the true tip in W in m/s, without tremor; NaN outside the tissue."""
    known = is_known(log.needle_tip)
    speed = np.full(len(log.time), np.nan)
    if known.sum() < 2:
        return speed
    time, tip = log.time[known], log.needle_tip[known]
    half = 0.5 * min(window, time[-1] - time[0])
    middle = np.clip(time, time[0] + half, time[-1] - half)
    steps = 0.5 * (tip[1:] + tip[:-1]) * np.diff(time)[:, np.newaxis]
    integral = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    before, now, after = (
        np.stack([np.interp(t, time, column) for column in integral.T], axis=1)
        for t in (middle - half, middle, middle + half)
    )
    speed[known] = np.linalg.norm(after - 2 * now + before, axis=1) / half**2
    return speed


@dataclass(frozen=True, kw_only=True)
class EstimateErrors:
    """Errors of the estimate after each of v volumes; NaN without an estimate or a needle."""

    tip: Floats  # (v,) distance from the true tip, in m
    axial: Floats  # part along the needle, positive beyond its tip
    lateral: Floats  # part across it
    axis: Floats  # (v,) angle to the true direction, from where it was first seen, in rad
    in_probe: Floats  # (v,) distance in P, in m: errors of the measured pose do not count


def estimate_errors(log: RunLog) -> EstimateErrors:
    """Compare the estimate after each volume with ground truth at the estimate's time."""
    time = log.volume_estimate_time
    tip = at_times(log, log.needle_tip, time)
    true = _true_direction(log)
    estimated = unit(log.volume_estimate_tip - log.volume_estimate_entry)
    miss = log.volume_estimate_tip - tip
    axial = np.sum(miss * true, axis=1)
    sine = np.linalg.norm(np.cross(true, estimated), axis=1)
    seen = in_frame(at_times(log, log.measured_X_WP, time), log.volume_estimate_tip)
    lies = in_frame(at_times(log, log.X_WP, time), tip)
    return EstimateErrors(
        tip=np.linalg.norm(miss, axis=1),
        axial=axial,
        lateral=np.linalg.norm(miss - axial[:, np.newaxis] * true, axis=1),
        axis=np.arctan2(sine, np.sum(true * estimated, axis=1)),
        in_probe=np.linalg.norm(seen - lies, axis=1),
    )


def normalized_squared_errors(errors: Floats, covariances: Floats) -> Floats:
    """Return (v,) squared Mahalanobis distances (NEES); NaN where anything is unknown."""
    result = np.full(len(errors), np.nan)
    known = is_known(errors) & is_known(covariances.reshape(-1, 9))
    inverse = np.linalg.pinv(covariances[known], rcond=1e-9, hermitian=True)
    result[known] = np.einsum("ni,nij,nj->n", errors[known], inverse, errors[known])
    return result


def stated_errors(log: RunLog, *, across_depth: bool = False) -> Mapping[str, tuple[Floats, int]]:
    """Return (v,) squared errors of tip, axis and velocity, relative to what is stated of them."""
    time = log.volume_estimate_time
    tip, before, after = (
        at_times(log, log.needle_tip, time + shift) for shift in (0, -_WINDOW / 2, _WINDOW / 2)
    )
    # For the parts that count, a projection on them and their number.
    across, number = np.broadcast_to(np.eye(3), (len(time), 3, 3)), 3
    if across_depth:
        across, number = across - _outer(at_times(log, log.X_WP, time)[:, :3, 1]), 2
    needle = log.volume_estimate_tip - log.volume_estimate_entry
    true, estimated = (_projected(across, each) for each in (_true_direction(log), needle))
    # The direction turns in a plane across it, and in a projection further than in space.
    length = np.linalg.norm(estimated, axis=1) / np.linalg.norm(needle, axis=1)
    turn = length[:, np.newaxis] * (unit(estimated) - unit(true))
    aside = across - _outer(unit(estimated))
    velocity = log.volume_estimate_velocity - (after - before) / _WINDOW

    def squared(errors: Floats, covariances: Floats, projections: Floats = across) -> Floats:
        projected = projections @ covariances @ projections
        return normalized_squared_errors(_projected(projections, errors), projected)

    axis = squared(turn, log.volume_estimate_direction_covariance, aside)
    axis[(np.sum(estimated * true, axis=1) < 0) & ~np.isnan(axis)] = np.inf
    missed = log.volume_estimate_tip - tip
    return {
        "tip": (squared(missed, log.volume_estimate_tip_covariance), number),
        "axis": (axis, number - 1),
        "velocity": (squared(velocity, log.volume_estimate_velocity_covariance), number),
    }


def inside_stated(log: RunLog, *, across_depth: bool = False) -> dict[str, list[bool | None]]:
    """Return for each volume whether the truth lies inside the stated 95 %; None if not stated."""
    return {
        name: [None if np.isnan(each) else bool(each <= squared_distance(0.95, freedom))
               for each in squared]
        for name, (squared, freedom) in stated_errors(log, across_depth=across_depth).items()
    }  # fmt: skip


def consistency(log: RunLog, judged: Mask) -> dict[str, dict[str, float | None]]:
    """Compare the errors of tip, axis and velocity in judged volumes with what is stated of them.

    Returns `nees`, the median squared error over that of the chi-squared distribution (more than 1
    if the uncertainty is stated too small), and `within_95`, the share inside the stated 95 %.
    """
    figures: dict[str, dict[str, float | None]] = {}
    for name, (every, freedom) in stated_errors(log).items():
        squared = every[judged & ~np.isnan(every)]
        figures[name] = {"nees": None, "within_95": None}
        if len(squared):
            within = squared <= squared_distance(0.95, freedom)
            nees = float(np.median(squared) / squared_distance(0.5, freedom))
            figures[name] = {"nees": nees, "within_95": float(within.mean())}
    return figures


def _outer(directions: Floats) -> Floats:
    return directions[:, :, np.newaxis] * directions[:, np.newaxis, :]


def _projected(projections: Floats, vectors: Floats) -> Floats:
    return np.asarray(np.einsum("nij,nj->ni", projections, vectors))


def _true_direction(log: RunLog) -> Floats:
    points = at_times(log, log.needle_points, log.volume_estimate_time)
    return _direction(points, log.volume_estimate_entry)


def in_frame(X_WP: Floats, p_W: Floats) -> Floats:
    """Return (m, 3) positions in W, in m, as seen in frames at (m, 4, 4) poses."""
    return np.einsum("nji,nj->ni", X_WP[:, :3, :3], p_W - X_WP[:, :3, 3])


def _direction(points: Floats, entry: Floats) -> Floats:
    """Return (v, 3) directions from where each is first seen, or its last tenth, to the tip."""
    direction = np.full((len(points), 3), np.nan)
    known = is_known(points).all(axis=1) & is_known(entry)
    if known.any():
        u = np.linspace(0, 1, 201)
        curves = CubicSpline(np.linspace(0, 1, points.shape[1]), points[known], axis=1)(u)
        distances = np.linalg.norm(curves - entry[known, np.newaxis], axis=2)
        first = np.minimum(np.argmin(distances, axis=1), 180)
        direction[known] = unit(curves[:, -1] - curves[np.arange(len(curves)), first])
    return direction


def at_times(log: RunLog, values: Floats, time: Floats) -> Floats:
    """Interpolate a column of the samples at other times; NaN if the nearest sample is NaN."""
    if len(log.time) == 0:
        return np.full((len(time), *values.shape[1:]), np.nan)
    flat = values.reshape(len(values), -1)
    known = is_known(flat)
    if not known.any():
        return np.full((len(time), *values.shape[1:]), np.nan)
    columns = [np.interp(time, log.time[known], column) for column in flat[known].T]
    result = np.stack(columns, axis=1)
    after = np.clip(np.searchsorted(log.time, time), 1, max(len(log.time) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(log.time) - 1)
    nearest = np.where(time - log.time[before] <= log.time[after] - time, before, after)
    result[~known[nearest] | ~np.isfinite(time)] = np.nan
    return result.reshape(len(time), *values.shape[1:])


def is_known(rows: Floats) -> Mask:
    """Return an (m,) mask of the rows that are finite throughout."""
    return np.asarray(np.isfinite(rows).all(axis=-1))


_POINTS, _EVERY = 1001, 10
"""Points on each curve (0.1 mm apart on 100 mm), and the step between the points evaluated.

The tip is always among the points evaluated.
"""


def curve_deviations(log: RunLog, geometry: SweepGeometry) -> Floats:
    """Return the (v,) largest distances in the image of true and estimated needle, in m."""
    time = log.volume_estimate_time
    true = at_times(log, log.needle_points, time)
    poses = at_times(log, log.X_WP, time)
    result = np.full(len(time), np.nan)
    for k, estimate in enumerate(log.volume_estimate_points):
        if np.isfinite(estimate).all() and np.isfinite(true[k]).all():
            X_PW = np.linalg.inv(poses[k])
            curves = [points @ X_PW[:3, :3].T + X_PW[:3, 3] for points in (true[k], estimate)]
            result[k] = deviation(curves[0], NeedleCurve(curves[1]), geometry)
    return result


def deviation(true: Floats, estimate: NeedleCurve, geometry: SweepGeometry) -> float:
    """Return the largest distance in m of two curves in the image; NaN if one lies outside."""
    u = np.linspace(0, 1, _POINTS)
    truth, guess = CubicSpline(np.linspace(0, 1, len(true)), true)(u), estimate.position(u)
    first = int(np.argmin(np.linalg.norm(truth - guess[0], axis=1)))
    largest = [
        cdist(points[geometry.contains(points)], other).min(axis=1)
        for points, other in ((truth[first:][::-_EVERY], guess), (guess[::-_EVERY], truth))
    ]
    if not all(map(len, largest)):
        return float("nan")
    return float(np.concatenate(largest).max())
