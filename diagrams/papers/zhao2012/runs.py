"""Runs of the reproduction of Zhao 2012, and their errors."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.phantom import (
    DIRECTION,
    TOWARDS,
    Phantom,
    StraightNeedle,
)
from sonoservo.diagrams.papers.zhao2012.published_tracking import PublishedTracking
from sonoservo.diagrams.papers.zhao2012.tracking import (
    BMode,
    Noise,
    Tracking,
    localize_as_published,
)
from sonoservo.diagrams.studies.following.analysis import run_case as run_loop
from sonoservo.diagrams.studies.study import Case, WithFiles
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis_tip_filter import direction_angles

Floats = NDArray[np.float64]

ESTIMATORS = ("ransac_sample", "ransac", "published", "ours", "kalman", "kalman_velocity")
"""Estimators: the best sample of RANSAC alone; RANSAC with the published local optimization; that
with the published filter and search window; RANSAC in our tracker; the same with the Kalman filter;
and with the velocity of the speckle as well."""

SPEEDOMETERS = ("velocimeter", "differenced", "without", "with", "published")
"""Sources of the tip's velocity: our velocimeter inside the tracker; the difference of the tips of
two volumes by RANSAC; our filter without and with the velocimeter; the published filter."""

QUANTITIES = ("alpha", "beta", "x", "y", "z", "tip")
"""Errors: angles in deg; tip along the array, in elevation, in depth, and its distance in mm."""

_CENTRE = np.array([0.0, 0.0, -15e-3])
"""Centre of a needle of 20 mm in T, in m, at the focus; not published."""
_HALF = 10e-3
_SPREAD = 0.3e-3
_LATERAL_ELEVATION_DEPTH = np.diag([1.0, 1.0, -1.0])


@cache
def _b_mode(geometry: SweepGeometry) -> BMode:
    return BMode(geometry)


def _phantom(settings: Mapping[str, Any]) -> Phantom:
    """Return a phantom with speckle of its own and its needle up to 0.3 mm off the grid."""
    seed = settings["phantom"]
    direction = np.array(settings.get("direction", DIRECTION))
    direction = direction / np.linalg.norm(direction)
    aside = np.random.default_rng([seed, 4]).uniform(-_SPREAD, _SPREAD, 3)
    aside[2] -= 1e-3 * settings.get("deeper_mm", 0.0)
    return Phantom(StraightNeedle(_CENTRE - _HALF * direction + aside, direction), seed)


def _errors(curve: NeedleCurve | None, needle: StraightNeedle, length: float) -> list[float | None]:
    """Return the errors of an estimate for the `QUANTITIES`."""
    if curve is None:
        return [None] * len(QUANTITIES)
    image = _LATERAL_ELEVATION_DEPTH
    angles = direction_angles(image @ curve.direction) - direction_angles(image @ needle.direction)
    angles = (angles + np.pi) % (2 * np.pi) - np.pi
    aside = 1e3 * (image @ (curve.tip - needle.tip(length)))
    return [*np.degrees(angles).tolist(), *aside.tolist(), float(np.linalg.norm(aside))]


class _Estimators:
    """All `ESTIMATORS` on sweeps of needles of known lengths; the true needle serves the errors."""

    def __init__(self, needle: StraightNeedle, seed: int) -> None:
        self._needle = needle
        self._rng = np.random.default_rng([seed, 5])
        self._without = Tracking(TOWARDS, seed, with_velocity=False)
        self._tracker = Tracking(TOWARDS, seed)
        self._published = PublishedTracking(TOWARDS, seed)
        self._tip: tuple[float, Floats] | None = None
        self.errors: list[list[list[float | None]]] = []
        self.speeds: list[list[float | None]] = []
        self.seconds: list[float] = []

    def __call__(
        self,
        sweep: RadioFrequencySweep,
        volume: Volume,
        length: float,
        change: float | None = None,
    ) -> None:
        began = time.perf_counter()
        tracked = self._tracker(sweep, volume)
        self.seconds.append(time.perf_counter() - began)
        curves: list[NeedleCurve | None] = []
        for refits in (0, 1):
            found = localize_as_published(volume, TOWARDS, refits, self._rng)
            curves.append(None if isinstance(found, NotFound) else found.curve)
        published = self._published(sweep, volume, change)
        without = self._without(sweep, volume).estimate
        measured = tracked.measurement
        ours = None if isinstance(measured, NotFound) else measured.curve
        estimate = tracked.estimate
        tip = None if curves[1] is None else curves[1].tip
        velocities = (
            None if isinstance(tracked.velocity, NotFound) else tracked.velocity.velocity,
            self._difference(volume.time, tip),
            without.tip_velocity if without else None,
            estimate.tip_velocity if estimate else None,
            published.velocity,
        )
        k = self._needle.direction
        self.speeds.append([None if v is None else 1e3 * float(v @ k) for v in velocities])
        curves += [published.curve, ours, without.curve, estimate.curve]
        self.errors.append([_errors(curve, self._needle, length) for curve in curves])

    def _difference(self, now: float, tip: Floats | None) -> Floats | None:
        """Return the velocity from the tips that RANSAC found in this volume and the one before."""
        before, self._tip = self._tip, None if tip is None else (now, tip)
        if before is None or tip is None:
            return None
        return np.asarray((tip - before[1]) / (now - before[0]))


def run_dynamic(case: Case) -> Mapping[str, Any]:
    """Track a needle that is pushed from 5 mm on."""
    settings = case.settings
    phantom = _phantom(settings)
    b_mode = _b_mode(phantom.renderer.geometry)
    estimators = _Estimators(phantom.needle, case.seed)
    speeds, interval = [0.0, *settings["speeds_mm_s"]], settings["interval_s"]
    b_mode_seconds = []
    length = 5e-3
    for number, speed in enumerate(speeds):
        length += 1e-3 * speed * interval
        sweep = phantom.sweep(length, number * interval)
        began = time.perf_counter()
        volume = b_mode(sweep)
        b_mode_seconds.append(time.perf_counter() - began)
        change = None
        if settings.get("commanded", False):
            change = 1e-3 * (speed - speeds[max(number - 1, 0)])
        estimators(sweep, volume, length, change)
    return {
        "errors": estimators.errors,
        "speeds_mm_s": estimators.speeds,
        "compute_s": np.add(b_mode_seconds, estimators.seconds).tolist(),
    }


def run_static(case: Case) -> Mapping[str, Any]:
    """Localize and track needles of several lengths at rest, in repetitions of the same volume."""
    phantom = _phantom(case.settings)
    b_mode = _b_mode(phantom.renderer.geometry)
    errors = []
    for length_mm in case.settings["lengths_mm"]:
        estimators = _Estimators(phantom.needle, case.seed)
        sweep = phantom.sweep(1e-3 * length_mm, 0.0)
        volume = b_mode(sweep)
        for number in range(case.settings["volumes"]):
            again = replace(sweep, motion=sweep.motion.at_once(float(number)))
            assert volume.motion is not None
            motion = volume.motion.at_once(float(number))
            same = replace(volume, motion=motion, time=motion.time)
            estimators(again, same, 1e-3 * length_mm)
        errors.append(estimators.errors)
    return {"errors": errors}


def run_open_values(case: Case) -> Mapping[str, Any]:
    """Push a needle; track it by RANSAC and the published filter with each of the `noises`."""
    settings, phantom = case.settings, _phantom(case.settings)
    b_mode, rng = _b_mode(phantom.renderer.geometry), np.random.default_rng([case.seed, 5])
    trackers = {
        name: PublishedTracking(TOWARDS, case.seed, replace(Noise(), **changes))
        for name, changes in settings["noises"].items()
    }
    tips: dict[str, list[float | None]] = {name: [] for name in ("RANSAC", *trackers)}
    for number in range(settings["volumes"]):
        time = number * settings["interval_s"]
        length = 1e-3 * (5 + settings["speed_mm_s"] * time)
        sweep = phantom.sweep(length, time)
        volume = b_mode(sweep)
        found = localize_as_published(volume, TOWARDS, 1, rng)
        curves = {"RANSAC": None if isinstance(found, NotFound) else found.curve}
        curves |= {name: track(sweep, volume).curve for name, track in trackers.items()}
        for name, curve in curves.items():
            tips[name].append(_errors(curve, phantom.needle, length)[-1])
    return {"tip_mm": tips}


def run_kept_voxels(case: Case) -> Mapping[str, Any]:
    """Localize one needle by the published RANSAC with several numbers of kept voxels."""
    phantom, rng = _phantom(case.settings), np.random.default_rng([case.seed, 6])
    length = 1e-3 * case.settings["length_mm"]
    volume = _b_mode(phantom.renderer.geometry)(phantom.sweep(length, 0.0))
    tips = []
    for kept_mm3 in case.settings["kept_mm3"]:
        found = localize_as_published(volume, TOWARDS, 1, rng, 1e-9 * kept_mm3)
        curve = None if isinstance(found, NotFound) else found.curve
        tips.append(_errors(curve, phantom.needle, length)[-1])
    return {"tip_mm": tips}


RUNS: Mapping[str, Callable[[Case], Mapping[str, Any] | WithFiles]] = {
    "static": run_static,
    "dynamic": run_dynamic,
    "kept voxels": run_kept_voxels,
    "open values": run_open_values,
    "closed loop": run_loop,
    "speed in the loop": run_loop,
}


def run_case(case: Case) -> Mapping[str, Any] | WithFiles:
    """Run a case of the experiment that the first part of its name selects."""
    return RUNS[case.experiment.split(",")[0]](case)
