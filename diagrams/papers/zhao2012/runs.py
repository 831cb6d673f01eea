"""Runs of the reproduction of Zhao 2012, and their errors."""

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.papers.zhao2012.phantom import DIRECTION, Phantom, StraightNeedle
from sonoservo.diagrams.papers.zhao2012.tracking import (
    VELOCIMETER,
    BMode,
    Tracking,
    localize_as_published,
)
from sonoservo.diagrams.studies.study import Case
from sonoservo.systems.estimation.axis_tip_filter import direction_angles
from sonoservo.systems.localization.speckle_velocimeter import measure_velocity
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.signals.volume import Volume

ESTIMATORS = ("ransac_sample", "ransac", "ours", "kalman", "kalman_velocity")
"""Estimators: the best sample of RANSAC alone; RANSAC with the published local optimization; RANSAC
in the tracker; the same with the Kalman filter; and with the velocity of the speckle as well."""

QUANTITIES = ("alpha", "beta", "x", "y", "z", "tip")
"""Errors: angles in deg; tip along the array, in elevation, in depth, and its distance in mm."""

VOLUMES = 16
"""Number of volumes of the published insertion."""

_START = np.array([-9.4e-3, 0.0, -11.6e-3])
"""Rear end of the needle in T, in m: at 20 mm, it is centred in the image; not published."""
_SPREAD = 0.3e-3
_LATERAL_ELEVATION_DEPTH = np.diag([1.0, 1.0, -1.0])
_PREDICTION_DEVIATION = 0.1e-3


@cache
def _b_mode(geometry: SweepGeometry) -> BMode:
    return BMode(geometry)


def _phantom(seed: int) -> Phantom:
    """Return a phantom with speckle of its own and its needle shifted by up to 0.3 mm.

    The shift prevents the needle from being aligned with the grid.
    """
    aside = np.random.default_rng([seed, 4]).uniform(-_SPREAD, _SPREAD, 3)
    return Phantom(StraightNeedle(_START + aside, DIRECTION), seed)


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
    """All `ESTIMATORS` on sweeps of needles of known lengths, and their errors.

    Parameters
    ----------
    needle
        True needle, used for the errors only.
    seed
        Seed of the random samples.
    """

    def __init__(self, needle: StraightNeedle, seed: int) -> None:
        self._needle = needle
        self._rng = np.random.default_rng([seed, 5])
        self._without = Tracking(DIRECTION, seed, with_velocity=False)
        self._tracker = Tracking(DIRECTION, seed)
        self.errors: list[list[list[float | None]]] = []
        self.velocities: list[list[float | None]] = []
        self.seconds: list[float] = []

    def __call__(self, sweep: RadioFrequencySweep, volume: Volume, length: float) -> None:
        began = time.perf_counter()
        tracked = self._tracker(sweep, volume)
        self.seconds.append(time.perf_counter() - began)
        curves: list[NeedleCurve | None] = []
        for refits in (0, 1):
            found = localize_as_published(volume, DIRECTION, refits, self._rng)
            curves.append(None if isinstance(found, NotFound) else found.curve)
        measured, velocity = tracked.measurement, tracked.velocity
        curves.append(None if isinstance(measured, NotFound) else measured.curve)
        curves += [self._without(sweep, volume).estimate.curve, tracked.estimate.curve]
        self.errors.append([_errors(curve, self._needle, length) for curve in curves])
        self.velocities.append(
            (1e3 * velocity.velocity).tolist()
            if isinstance(velocity, VelocityMeasurement)
            else [None] * 3
        )


def run_dynamic(case: Case) -> Mapping[str, Any]:
    """Track a needle pushed at 1 mm/s from 5 mm on, with one volume per second."""
    phantom = _phantom(case.settings["phantom"])
    b_mode = _b_mode(phantom.renderer.geometry)
    estimators = _Estimators(phantom.needle, case.seed)
    b_mode_seconds = []
    for number in range(case.settings["volumes"]):
        length = 5e-3 + 1e-3 * number
        sweep = phantom.sweep(length, float(number))
        began = time.perf_counter()
        volume = b_mode(sweep)
        b_mode_seconds.append(time.perf_counter() - began)
        estimators(sweep, volume, length)
    return {
        "errors": estimators.errors,
        "velocities_mm_s": estimators.velocities,
        "seconds": np.add(b_mode_seconds, estimators.seconds).tolist(),
    }


def run_static(case: Case) -> Mapping[str, Any]:
    """Localize and track needles of several lengths at rest, in repetitions of the same volume."""
    phantom = _phantom(case.settings["phantom"])
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


def run_velocimeter(case: Case) -> Mapping[str, Any]:
    """Measure the speed of needles between two volumes, with the search centred 0.1 mm off."""
    phantom, rng = _phantom(case.settings["phantom"]), np.random.default_rng([case.seed, 6])
    length = 10e-3
    before = phantom.sweep(length, 0.0)
    found: list[list[float | None]] = []
    for speed_mm_s in case.settings["speeds_mm_s"]:
        longer = length + 1e-3 * speed_mm_s
        velocity = measure_velocity(
            phantom.sweep(longer, 1.0),
            before,
            phantom.needle.tip(length),
            phantom.needle.tip(longer) + _PREDICTION_DEVIATION * rng.normal(size=3),
            DIRECTION,
            VELOCIMETER,
        )
        if isinstance(velocity, VelocityMeasurement):
            found.append([*(1e3 * velocity.velocity).tolist(), velocity.correlation])
        else:
            found.append([None] * 4)
    return {"velocities_mm_s": found}


def run_closed_loop(case: Case) -> Mapping[str, Any]:
    """Run a scenario with one of the trackers."""
    experiment = FollowingExperiment(
        load_scenario(case.settings["scenario"], seed=case.seed, changes=case.settings["changes"])
    )
    experiment.run()
    return experiment.summarize(experiment.log())


RUNS = {
    "static": run_static,
    "dynamic": run_dynamic,
    "velocimeter": run_velocimeter,
    "closed loop": run_closed_loop,
}


def run_case(case: Case) -> Mapping[str, Any]:
    """Run a case of the experiment that the first part of its name selects."""
    return RUNS[case.experiment.split(",")[0]](case)
