"""Success of a run, one definition for studies, verdicts, tables and the exit status."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sonoservo.systems.evaluation.labels import look_up
from sonoservo.systems.evaluation.run_errors import Floats, at_times, in_frame
from sonoservo.systems.evaluation.run_log import RunLog, unit
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.volume import Volume

ENOUGH_MM = 10.0  # length of the needle to be seen in a volume from which the volume counts, in mm

FOUND_MM, FOUND_DEG = 5.0, 5.0
"""Errors of tip and axis within which a tracked needle is the right one."""

KEPT = 0.95  # share of the volumes after the detection in which a kept needle is the right one
SUCCESS_MM, SUCCESS_DEG = 2.0, 2.0  # median errors of tip and axis of a success


@dataclass(frozen=True, eq=False)
class TrackedVolumes:
    """Results of a tracker in the v volumes of a run, judged against ground truth."""

    tip: Floats  # (v,) errors in mm; infinite without an estimate or a needle
    axis: Floats  # the same, in deg
    tracking: NDArray[np.bool_]  # (v,) volumes that confirmed a needle
    to_be_seen: Floats  # (v,) length in mm that stands out, or else that in view

    @classmethod
    def of(cls, log: RunLog) -> "TrackedVolumes":
        """Return the volumes of a log; without the length in view, that in the tissue counts."""
        tip, axis = judged_errors(log)
        in_view, inside = (
            at_times(log, each, log.volume_time)
            for each in (log.visible_length, log.inserted_length)
        )
        return cls(
            tip=finite_or_infinite(1e3 * tip),
            axis=finite_or_infinite(np.rad2deg(axis)),
            tracking=log.volume_estimate_mode == TrackingMode.TRACKING,
            to_be_seen=1e3 * np.nan_to_num(np.where(np.isfinite(in_view), in_view, inside)),
        )

    @cached_property
    def right(self) -> NDArray[np.bool_]:
        """(v,) mask of the volumes in which the right needle is tracked."""
        return self.tracking & (self.tip <= FOUND_MM) & (self.axis <= FOUND_DEG)

    @property
    def found(self) -> bool:
        """True if the right needle is tracked at all."""
        return bool(self.right.any())

    @cached_property
    def judged(self) -> NDArray[np.bool_]:
        """(v,) mask of the volumes from the detection on with enough of the needle to be seen."""
        return (np.cumsum(self.right) > 0) & (self.to_be_seen >= ENOUGH_MM)

    @property
    def kept(self) -> bool:
        """True if the needle is found, and the right one is tracked in 95 % of these volumes."""
        return bool(self.judged.any() and self.right[self.judged].mean() >= KEPT)

    @property
    def success(self) -> bool:
        """True if the needle is kept, with median errors of at most 2 mm and 2 deg."""
        if not self.kept:
            return False
        tip, axis = (np.median(each[self.judged]) for each in (self.tip, self.axis))
        return bool(tip <= SUCCESS_MM and axis <= SUCCESS_DEG)

    def figures(self) -> dict[str, Any]:
        """Return the judgement for a summary."""
        return {
            "found": self.found,
            "kept": self.kept,
            "success": self.success,
            "right": int(np.sum(self.right & self.judged)),
            "judged": int(np.sum(self.judged)),
        }


def finite_or_infinite(errors: Floats) -> Floats:
    """Return errors with infinity in place of unknown ones."""
    return np.where(np.isfinite(errors), errors, np.inf)


def judged_errors(log: RunLog, *, across_depth: bool = False) -> tuple[Floats, Floats]:
    """Return (v,) errors of tip in m and of direction (the needle's front half) in rad."""
    time = log.volume_estimate_time
    X_WP, points = at_times(log, log.X_WP, time), at_times(log, log.needle_points, time)
    ends = log.volume_estimate_tip, log.volume_estimate_entry
    middle, true_tip, tip, entry = (
        in_frame(X_WP, each) for each in (points[:, points.shape[1] // 2], points[:, -1], *ends)
    )
    counted = np.array([1.0, 0.0, 1.0]) if across_depth else np.ones(3)
    true, estimated = unit(counted * (true_tip - middle)), unit(counted * (tip - entry))
    sine = np.linalg.norm(np.cross(true, estimated), axis=1)
    angle = np.arctan2(sine, np.sum(true * estimated, axis=1))
    return np.linalg.norm(counted * (tip - true_tip), axis=1), angle


def from_needle(log: RunLog, time: Floats, p_W: Floats) -> Floats:
    """Return (m,) distances in m of points in W from the true needle; NaN without one."""
    tip, entry = at_times(log, log.needle_tip, time), at_times(log, log.needle_entry, time)
    along = np.sum((p_W - entry) * (tip - entry), axis=1)
    squared = np.sum((tip - entry) ** 2, axis=1)
    u = np.clip(along / np.where(squared > 0, squared, 1.0), 0, 1)[:, np.newaxis]
    return np.asarray(np.linalg.norm(p_W - (entry + u * (tip - entry)), axis=1))


class RunOutcome(Enum):
    """Outcome of a run in which a robot follows a needle: the gravest that applies."""

    STOPPED = "stopped by the guard"
    UNTOUCHED = "never touched the body"
    NOT_FOUND = "not found"
    NOT_KEPT = "found, not kept"
    INACCURATE = "kept, but inaccurate"
    SUCCESS = "found and kept"


def run_outcome(summary: Mapping[str, Any]) -> RunOutcome:
    """Return the outcome of a run, from its summary; see `summarize`."""
    if look_up(summary, "guard.stopped_at_end"):
        return RunOutcome.STOPPED
    if look_up(summary, "force.touched") is False:
        return RunOutcome.UNTOUCHED
    if not look_up(summary, "success.found"):
        return RunOutcome.NOT_FOUND
    if not look_up(summary, "success.kept"):
        return RunOutcome.NOT_KEPT
    return RunOutcome.SUCCESS if look_up(summary, "success.success") else RunOutcome.INACCURATE


def succeeds(summary: Mapping[str, Any]) -> bool:
    """Return True if a run is a success: the needle was found, kept and tracked accurately."""
    return run_outcome(summary) is RunOutcome.SUCCESS


STANDS_OUT_DB = 6.0  # level over the tissue from which a needle stands out, in dB

_STEP, _AVERAGED = 0.5e-3, 3e-3
"""Distance between samples along the needle, and length of the average that takes out speckle, in
m."""

_NEAR = 0.5e-3 * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
"""Offsets across the needle at which its echo is sampled, in m."""

_TURNS = np.arange(8) * np.pi / 4
_AROUND = np.concatenate(
    [r * np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1) for r in (4e-3, 5e-3, 6e-3)]
)
"""Offsets across the needle at which the tissue is sampled, in m."""

_DEPTHS = np.linspace(0.92, 1.08, 17)
"""Factors of the depth, by which a wrong speed of sound displaces the needle's echo."""


def conspicuous_length(volume: Volume, points: Floats) -> float:
    """Return the length of a needle that stands 6 dB or more over the tissue around it, in m.

    `points` are (n, 3) positions in P along the needle from entry to tip, in m, where the volume
    would show them if its depth were right. The depth is scaled by up to 8 % to where the needle is
    brightest, as a wrong speed of sound displaces it.
    """
    ends = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    samples = np.arange(_STEP / 2, ends[-1], _STEP)
    if len(samples) < 2:
        return 0.0
    axis = np.stack([np.interp(samples, ends, each) for each in points.T], axis=1)
    scaled = [axis * [1.0, factor, 1.0] for factor in _DEPTHS]
    axis = max(scaled, key=lambda each: float(volume.sample(_beside(each, _NEAR)).mean()))
    shown = volume.sees(axis)
    around = volume.sample(beside := _beside(axis, _AROUND))
    count = np.count_nonzero(volume.sees(beside), axis=0)
    echo = volume.sample(_beside(axis, _NEAR)).mean(axis=0)
    tissue = around.sum(axis=0) / np.maximum(count, 1)
    over = volume.decibels_per_level * uniform_filter1d(echo - tissue, round(_AVERAGED / _STEP))
    return _STEP * np.count_nonzero(shown & (count > 0) & (over >= STANDS_OUT_DB))


def _beside(axis: Floats, offsets: Floats) -> Floats:
    """Return (m, n, 3) positions beside a needle at (m, 2) offsets across it."""
    k = np.gradient(axis, axis=0)
    k /= np.linalg.norm(k, axis=1, keepdims=True)
    # Any normal will do: the offsets surround the needle.
    least = np.eye(3)[int(np.abs(k).mean(axis=0).argmin())]
    aside = np.cross(k, least)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    up = np.cross(k, aside)
    u, v = offsets.T[..., np.newaxis, np.newaxis]
    return np.asarray(axis + u * aside + v * up)
