"""Runs of the reproduction of Carriere 2016: one needle, with every estimator."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.experiments.shape_prediction import ShapePredictionExperiment
from sonoservo.diagrams.experiments.shape_prediction_scenario import ESTIMATORS
from sonoservo.diagrams.shape_predictor import estimate_shape
from sonoservo.diagrams.studies.study import Case
from sonoservo.systems.evaluation.shape.shape_log import ShapeLog
from sonoservo.systems.evaluation.shape.shape_metrics import plane_of, prediction, summarize_shape
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.needle_shape import NeedleShape

Floats = NDArray[np.float64]

SETS = ("d60", "d80", "patient")

UNEVEN = "d60_uneven"
"""Name of the first set repeated with a curvature that the estimators do not model."""

BEVEL_MARK_DEG = 60.0
"""Accuracy in deg with which the filter as printed is given the bevel's direction."""


def run_needle(case: Case) -> dict[str, Any]:
    """Push one needle, and predict its shape with every estimator.

    Returns
    -------
    Summary of the run, `estimators` with the figures of each, and the data of the plots.
    """
    _warm_up()
    experiment = _experiment(case.settings["scenario"], case.seed, case.settings["changes"])
    scenario = experiment.scenario
    experiment.run()
    log = experiment.log()
    found = experiment.cross_sections
    needle_path = experiment.insertion.path
    assert needle_path is not None
    estimators, paths = {}, {}
    for name in ESTIMATORS:
        shapes = estimate_shape(experiment.make_estimator(name), found)
        last = shapes[-1] if shapes else None
        if isinstance(last, NeedleShape):
            estimators[name] = prediction(log, last) | expected_errors(log, last)
            estimators[name]["by_depth"] = _errors_by_depth(shapes, log)
            paths[name] = last.predict(log.depth)[0]
    result = {
        **summarize_shape(log, experiment.shape),
        "estimators": estimators,
        "depth": log.depth,
        "true": log.true[:, :2],
        "measured": log.measured[:, :2],
        "paths": paths,
        "rotations": scenario.rotations,
        "observe_until": scenario.observe_until,
        "truth": {
            "radius_m": needle_path.radius,
            "angle_deg": np.rad2deg(needle_path.angle),
        },
    }
    if case.settings["keep_particles"]:
        result["particles"] = _particles(experiment, found)
    return result


def _experiment(name: str, seed: int, changes: Sequence[str] = ()) -> ShapePredictionExperiment:
    experiment = ShapePredictionExperiment(load_scenario(name, changes=list(changes), seed=seed))
    mark = np.random.default_rng([seed, 1]).uniform(-BEVEL_MARK_DEG, BEVEL_MARK_DEG)
    assert experiment.insertion.path is not None
    # The path's roll is measured from the upward direction, the plane from the lateral X of P.
    plane = np.rad2deg(experiment.insertion.path.roll) - 90
    experiment.scenario.published.bevel_direction_deg = float(plane + mark)
    return experiment


@cache
def _warm_up() -> None:
    """Compile everything before the first time is measured."""
    _experiment("carriere2016_patient", 100).run()


def expected_errors(log: ShapeLog, shape: NeedleShape) -> dict[str, float]:
    """Return the mean errors that an estimate predicts for itself, in the plane of most deflection.

    The mean of |e| is sqrt(2 / pi) standard deviations for a normal e. Against the measured path,
    the scatter of the measurements adds to the variance.
    """
    plane = plane_of(log.true)
    mean, covariance = shape.predict(log.depth)
    used = np.isfinite(log.measured[:, 0]) & (log.depth <= shape.observed + 1e-9)
    scatter = np.mean(((log.measured[used, :2] - mean[used]) @ plane) ** 2)
    variance = np.einsum("i,mij,j->m", plane, covariance, plane)
    figures = {}
    for against, each in (("true", variance), ("measured", variance + scatter)):
        size = np.sqrt(2 / np.pi * each)
        figures[f"expected_tip_{against}_mm"] = 1e3 * float(size[-1])
        figures[f"expected_shape_{against}_mm2"] = 1e6 * float(np.trapezoid(size, log.depth))
    return figures


def _errors_by_depth(shapes: Sequence[object], log: ShapeLog) -> dict[str, Floats]:
    """Return the error of the predicted tip and its stated 95 % bound after each slice, in mm."""
    rows: list[tuple[float, float, float]] = []
    for shape in shapes:
        if isinstance(shape, NeedleShape) and (not rows or shape.observed > rows[-1][0]):
            mean, covariance = shape.predict(log.depth[-1:])
            error = float(np.linalg.norm(mean[0] - log.true[-1, :2]))
            bound = RADIUS_95 * float(np.sqrt(np.linalg.eigvalsh(covariance[0])[-1]))
            rows.append((shape.observed, 1e3 * error, 1e3 * bound))
    return dict(zip(("depth", "error_mm", "bound_mm"), np.array(rows).T, strict=True))


def _particles(
    experiment: ShapePredictionExperiment, found: Sequence[CrossSection]
) -> dict[str, Any]:
    """Return R in m and theta_0 in deg of the particles: first, 5 slices after 10 mm, and last."""
    scenario = experiment.scenario
    points = [experiment.X_WP.inverse().multiply(each.position) for each in found]
    if scenario.observe_until is not None:
        points = [p_I for p_I in points if p_I[2] <= scenario.observe_until + 1e-9]
    counts = (0, sum(p_I[2] < 10e-3 for p_I in points) + 5, len(points))
    rng = np.random.default_rng(scenario.seed)
    filters = {name: experiment.make_filter(name) for name in ("particle_filter", "published")}
    beliefs = {name: each.begin(rng) for name, each in filters.items()}
    snapshots: dict[str, list[Floats]] = {name: [] for name in filters}
    for count in range(counts[-1] + 1):
        for name, each in filters.items():
            if count:
                beliefs[name] = each.update(beliefs[name], points[count - 1], rng)
        if count in counts:
            ours = beliefs["particle_filter"]
            chosen = rng.choice(len(ours.particles), 500, p=ours.normalized_weights)
            snapshots["particle_filter"].append(ours.particles[chosen, :2] * [1, 180 / np.pi])
            snapshots["published"].append(beliefs["published"].particles * [1, 180 / np.pi])
    return snapshots
