"""How far a run was from its truth, at every moment."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import cumulative_trapezoid

from sonoservo.systems.recording.run_log import RunLog, unit

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


def features(X_WP: ArrayLike, p_WTip: ArrayLike, p_WEntry: ArrayLike) -> Floats:
    """Return the visual features of Chatelain 2013, eq. 23.

    Parameters
    ----------
    X_WP
        (n, 4, 4) poses of the probe.
    p_WTip, p_WEntry
        (n, 3) positions in m.

    Returns
    -------
    (n, 3) array of x and z of the tip in P in m, and of theta = atan2(k_z, k_x), wrapped to
    +-pi/2, in rad.
    """
    X_WP, p_WTip = np.asarray(X_WP), np.asarray(p_WTip)
    R_PW = np.swapaxes(X_WP[:, :3, :3], 1, 2)
    tip = np.einsum("nij,nj->ni", R_PW, p_WTip - X_WP[:, :3, 3])
    k = np.einsum("nij,nj->ni", R_PW, p_WTip - np.asarray(p_WEntry))
    theta = np.arctan2(k[:, 2], k[:, 0])
    theta = (theta + np.pi / 2) % np.pi - np.pi / 2
    return np.stack([tip[:, 0], tip[:, 2], theta], axis=1)


def needle_speed(log: RunLog, window: float) -> Floats:
    """Speed of the true tip in W, without the hand's tremor.

    Parameters
    ----------
    log
        Of the run.
    window
        In s: the mean position in the half of it that follows is compared with that before.

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
        (v,) its part along the true needle, above zero beyond the true tip, and across it, in m.
    axis
        (v,) angle between the true and the estimated direction, entry to tip, in rad.
    """

    tip: Floats
    axial: Floats
    lateral: Floats
    axis: Floats


def estimate_errors(log: RunLog) -> EstimateErrors:
    """Compare the estimate after each volume with the truth at the estimate's time."""
    time = log.volume_estimate_time
    tip, entry = at_times(log, log.needle_tip, time), at_times(log, log.needle_entry, time)
    true = unit(tip - entry)
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
