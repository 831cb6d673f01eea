"""Errors of a run at every moment, against ground truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from sonoservo.systems.control.visual_features import needle_features
from sonoservo.systems.evaluation.run_log import RunLog, unit

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def features(X_WP: ArrayLike, p_WTip: ArrayLike, p_WEntry: ArrayLike) -> Floats:
    """Return the visual features of needles in W, see `needle_features`.

    Parameters
    ----------
    X_WP
        (n, 4, 4) poses of the probe.
    p_WTip, p_WEntry
        (n, 3) positions in m.

    Returns
    -------
    (n, 3) array of x and z of the tip in P in m, and of theta in rad; NaN for an unknown needle.
    """
    X_WP, p_WTip = np.asarray(X_WP), np.asarray(p_WTip)
    R_PW = np.swapaxes(X_WP[:, :3, :3], 1, 2)
    tip = np.einsum("nij,nj->ni", R_PW, p_WTip - X_WP[:, :3, 3])
    k = np.einsum("nij,nj->ni", R_PW, p_WTip - np.asarray(p_WEntry))
    each = [needle_features(*needle) for needle in zip(tip, k, strict=True)]
    return np.array(each, dtype=float).reshape(-1, 3)


def needle_speed(log: RunLog, window: float) -> Floats:
    """Speed of the true tip in W, without the hand's tremor.

    Parameters
    ----------
    log
        Log of the run.
    window
        Time in s: the mean position in the half of it that follows is compared with that before.

    Returns
    -------
    (n,) speed in m/s; NaN while the needle is outside.
    """
    known = is_known(log.needle_tip)
    speed = np.full(len(log.time), np.nan)
    if known.sum() < 2:
        return speed
    time, tip = log.time[known], log.needle_tip[known]
    half = 0.5 * min(window, time[-1] - time[0])
    middle = np.clip(time, time[0] + half, time[-1] - half)
    integral = cumulative_trapezoid(tip, time, axis=0, initial=0)
    before, now, after = (
        np.stack([np.interp(t, time, column) for column in integral.T], axis=1)
        for t in (middle - half, middle, middle + half)
    )
    speed[known] = np.linalg.norm(after - 2 * now + before, axis=1) / half**2
    return speed


@dataclass(frozen=True, kw_only=True)
class EstimateErrors:
    """Errors of the estimate after each volume, NaN where there is no estimate or no needle.

    Parameters
    ----------
    tip
        (v,) distance from the true to the estimated tip, in m.
    axial, lateral
        (v,) parts of that distance along the true needle, above zero beyond the true tip, and
        across it, in m.
    axis
        (v,) angle between the true and the estimated direction in rad. The estimate's runs from its
        entry to its tip; the true one from the point of the needle that is nearest to that entry,
        for before it a bent needle has not been seen.
    """

    tip: Floats
    axial: Floats
    lateral: Floats
    axis: Floats


def estimate_errors(log: RunLog) -> EstimateErrors:
    """Compare the estimate after each volume with the truth at the estimate's time."""
    time = log.volume_estimate_time
    tip = at_times(log, log.needle_tip, time)
    true = _direction(at_times(log, log.needle_points, time), log.volume_estimate_entry)
    estimated = unit(log.volume_estimate_tip - log.volume_estimate_entry)
    miss = log.volume_estimate_tip - tip
    axial = np.sum(miss * true, axis=1)
    sine = np.linalg.norm(np.cross(true, estimated), axis=1)
    return EstimateErrors(
        tip=np.linalg.norm(miss, axis=1),
        axial=axial,
        lateral=np.linalg.norm(miss - axial[:, np.newaxis] * true, axis=1),
        axis=np.arctan2(sine, np.sum(true * estimated, axis=1)),
    )


def _direction(points: Floats, entry: Floats) -> Floats:
    """Return the direction of needles from where they are first seen to their tips.

    Parameters
    ----------
    points
        (v, m, 3) evenly along each needle.
    entry
        (v, 3) where it is first seen.

    Returns
    -------
    (v, 3) unit vectors; NaN where anything is. A tenth of the needle is used at the least.
    """
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
    """Interpolate a column of the samples at other times; NaN where the nearest sample is."""
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
    """(m,) whether all of a row is finite."""
    return np.asarray(np.isfinite(rows).all(axis=-1))
