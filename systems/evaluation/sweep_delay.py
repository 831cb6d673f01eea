"""Delay between the frames of a freehand probe and their poses, from sweeps to and fro."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from sonoservo.systems.sampling.interpolation import sample_grid
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame, reconstruct

_LATEST, _STEPS = 0.25, 11
"""Largest delay in s that is looked for, and number of delays that are tried."""

_SPACING = 1.2e-3
_LEAST_VOXELS = 500
_LEAST_PAIRS = 2


def sweep_delay(sweeps: Sequence[Sequence[PosedFrame]]) -> tuple[float, float] | NotFound:
    """Return the delay of poses in s at which sweeps to and fro agree, and half its 95 %."""
    delays = [
        best
        for earlier, later in pairwise(sweeps)
        if (best := _best_delay(earlier, later)) is not None
    ]
    if len(delays) < _LEAST_PAIRS:
        return NotFound("fewer than three sweeps to and fro show the same tissue")
    count = len(delays)
    wide = float(student.ppf(0.975, count - 1)) / 2
    return float(np.mean(delays)), wide * float(np.std(delays, ddof=1)) / count**0.5


def _best_delay(earlier: Sequence[PosedFrame], later: Sequence[PosedFrame]) -> float | None:
    tried = np.linspace(-_LATEST, _LATEST, _STEPS)
    alike = np.array([_likeness(earlier, later, delay) for delay in tried])
    if not np.isfinite(alike).all():
        return None
    best = int(alike.argmax())
    if not 0 < best < _STEPS - 1:
        return None
    before, at, after = alike[best - 1 : best + 2]
    bend = before - 2 * at + after
    return float(tried[best] + (tried[1] - tried[0]) * 0.5 * (before - after) / bend)


def _likeness(earlier: Sequence[PosedFrame], later: Sequence[PosedFrame], delay: float) -> float:
    """Return the correlation of two sweeps whose poses are late by so much; NaN if they miss."""
    frames = [*earlier, *later]
    order = np.argsort([frame.time for frame in frames], kind="stable")
    times = np.array([frames[k].time for k in order])
    poses = np.array([frames[k].X_WI for k in order]).reshape(-1, 16)
    try:
        first, second = (
            reconstruct(_shifted(sweep, times, poses, delay), spacing=_SPACING)
            for sweep in (earlier, later)
        )
    except ValueError:  # too few frames are left, or the sweep is too large
        return np.nan
    inner = np.argwhere(~first.holes)[::3]
    X = second.X_WP.InvertAndCompose(first.X_WP)
    p = X.multiply(first.position(inner).T).T
    filled = sample_grid((~second.holes).astype(np.float32), p, second.origin, second.spacing, 0.0)
    there = filled > 0.99
    if there.sum() < _LEAST_VOXELS:
        return np.nan
    here = first.intensities[tuple(inner[there].T)].astype(float)
    other = sample_grid(second.intensities, p[there], second.origin, second.spacing, 0.0)
    if not np.ptp(here) or not np.ptp(other):
        return np.nan
    return float(np.corrcoef(here, other)[0, 1])


def _shifted(
    sweep: Sequence[PosedFrame],
    times: NDArray[np.float64],
    poses: NDArray[np.float64],
    delay: float,
) -> list[PosedFrame]:
    """Return frames with the poses that were stamped so much later; those beyond the last go."""
    shifted = []
    for frame in sweep:
        at = frame.time + delay
        if times[0] <= at <= times[-1]:
            entries = [np.interp(at, times, poses[:, k]) for k in range(16)]
            shifted.append(replace(frame, X_WI=np.reshape(entries, (4, 4))))
    return shifted
