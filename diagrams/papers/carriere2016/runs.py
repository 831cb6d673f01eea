"""Runs of the reproduction of Carriere 2016: one needle, with every method on the same slices."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.experiments.shape_prediction import ShapePredictionExperiment
from sonoservo.diagrams.experiments.shape_prediction_scenario import (
    ESTIMATORS,
    ShapePredictionScenario,
)
from sonoservo.diagrams.papers.carriere2016.method.shape_filter import (
    PublishedParticleFilterParameters,
)
from sonoservo.diagrams.papers.carriere2016.protocols import SWEEPS
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.diagrams.shape_predictor import estimate_shape, predict_from_slices
from sonoservo.diagrams.studies.study import Case
from sonoservo.systems.evaluation.shape.shape_metrics import (
    ShapeLog,
    TrueBend,
    deflection_bound,
    prediction,
    summarize_shape,
)
from sonoservo.systems.needle.steered_path import SteeredPath
from sonoservo.systems.shape.shape_particle_filter import ShapeParticleFilter
from sonoservo.systems.shape.shape_posterior import WanderParameters
from sonoservo.systems.signals.confidence import RADIUS_95
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.needle_shape import NeedleShape

Floats = NDArray[np.float64]

BEVEL_MARK_DEG = 60.0
"""Accuracy in deg with which the filter as printed is given the bevel's direction."""

TAUGHT, AS_PUBLISHED, EXACT = "taught", "as_published", "exact"
"""Names of the methods beside `ESTIMATORS`: our particle filter with the learnt wander, the whole
published method, and the printed filter on cross-sections without any error."""

SWEPT_ERRORS = (
    "tip_error_true_mm", "tip_error_measured_mm",
    "shape_error_true_mm2", "shape_error_measured_mm2",
)  # fmt: skip
"""Names of the errors that are kept of a sweep."""

UNTAUGHT = WanderParameters(spread=1.0, across_spread=1.0)
"""Distribution of the wander before the first needle is seen."""


def run_needle(case: Case) -> dict[str, Any]:
    """Push one needle; return its summary, each method's figures, and the data of the plots."""
    _warm_up()
    settings = case.settings
    experiment = _experiment(settings["scenario"], case.seed, settings["changes"])
    scenario = experiment.scenario
    slices: list[ImageSlice] = []
    experiment.start()
    experiment.advance(
        scenario.duration if settings["whole"] else _last_use(scenario),
        lambda each: slices.append(each.evaluate(each.slice_converter, "slice")),
    )
    log = _to_full_depth(experiment.log(), experiment)
    shapes: dict[str, Sequence[object]] = {
        name: estimate_shape(experiment.make_estimator(name), experiment.cross_sections)
        for name in ESTIMATORS
    }
    if settings["wander"] is not None:
        taught = replace(scenario.particle_filter, wander=WanderParameters(**settings["wander"]))
        shapes[TAUGHT] = estimate_shape(
            experiment.make_estimator("particle_filter", replace(scenario, particle_filter=taught)),
            experiment.cross_sections,
        )
    published = _published(experiment, case)
    shapes[EXACT] = estimate_shape(
        experiment.make_estimator("published", published), _exact(experiment, log)
    )
    logs = dict.fromkeys(shapes, log)
    found, shapes[AS_PUBLISHED] = predict_from_slices(experiment.make_predictor(published), slices)
    logs[AS_PUBLISHED] = _with(log, experiment, found)
    methods, paths = {}, {}
    for name, each in shapes.items():
        last = each[-1] if each else None
        methods[name] = {"tracking": summarize_shape(logs[name], None)["tracking"]}
        if isinstance(last, NeedleShape):
            methods[name] |= prediction(logs[name], last)
            methods[name]["by_depth"] = _errors_by_depth(each, log)
            paths[name] = last.predict(log.depth)[0]
    result = {
        **summarize_shape(log, experiment.shape),
        "methods": methods,
        "bound": _bound(experiment, log),
        "depth": log.depth,
        "true": log.true[:, :2],
        "measured": log.measured[:, :2],
        "paths": paths,
        "observe_until": scenario.observe_until,
        "sweeps": _sweeps(experiment, case, slices, log) if settings["sweeps"] else {},
    }
    if settings["keep"]:
        result |= _kept(experiment, slices)
    return result


def teach(case: Case) -> dict[str, float]:
    """Return the wander's distribution after one needle that is seen along its whole path."""
    experiment = _experiment(case.settings["scenario"], case.seed, case.settings["changes"])
    experiment.run()
    parameters = replace(experiment.scenario.particle_filter, wander=UNTAUGHT)
    whole = replace(experiment.scenario, particle_filter=parameters, observe_until=None)
    shape_filter = experiment.make_filter("particle_filter", whole)
    assert isinstance(shape_filter, ShapeParticleFilter)
    rng = np.random.default_rng(case.seed)
    belief = shape_filter.begin(rng)
    for each in experiment.cross_sections:
        p_I = experiment.X_WP.inverse().multiply(each.position)
        belief = shape_filter.update(belief, p_I, rng)
    learnt = shape_filter.learned_wander(belief)
    names = ("amplitude", "spread", "across", "across_spread", "length")
    return {name: getattr(learnt, name) for name in names}


def _experiment(name: str, seed: int, changes: Sequence[str] = ()) -> ShapePredictionExperiment:
    scenario = require_scenario(
        load_scenario(name, changes=list(changes), seed=seed), ShapePredictionScenario
    )
    experiment = ShapePredictionExperiment(scenario)
    _set_bevel(scenario, experiment)
    return experiment


def _set_bevel(scenario: ShapePredictionScenario, experiment: ShapePredictionExperiment) -> None:
    """Give the published filter the bevel's direction that the mark on the needle's hub shows."""
    mark = np.random.default_rng([scenario.seed, 1]).uniform(-BEVEL_MARK_DEG, BEVEL_MARK_DEG)
    assert experiment.insertion.path is not None
    assert isinstance(scenario.published, PublishedParticleFilterParameters)
    # The path's roll is measured from the upward direction, the plane from the lateral X of P.
    roll = float(np.rad2deg(experiment.insertion.path.roll))
    scenario.published.bevel_direction_deg = roll - 90 + mark


def _published(
    experiment: ShapePredictionExperiment, case: Case, changes: Sequence[str] = ()
) -> ShapePredictionScenario:
    """Return the scenario with the published method, and with changes of it."""
    scenario = require_scenario(
        load_scenario(
            case.settings["scenario"],
            changes=[*case.settings["changes"], *changes],
            seed=case.seed,
            as_published=True,
        ),
        ShapePredictionScenario,
    )
    _set_bevel(scenario, experiment)
    return scenario


@cache
def _warm_up() -> None:
    """Compile everything before the first time is measured."""
    _experiment("carriere2016_patient", 100).run()


def _last_use(scenario: ShapePredictionScenario) -> float:
    """Return the time in s just after the last slice that the estimators use."""
    used = round((scenario.observe_until or scenario.depth) / scenario.step)
    return (used + 1) * scenario.period + scenario.processing_time


def _to_full_depth(log: ShapeLog, experiment: ShapePredictionExperiment) -> ShapeLog:
    """Return a log with rows down to the full depth, for the slices that were not made."""
    scenario = experiment.scenario
    last = round(log.depth[-1] / scenario.step)
    rest = scenario.step * np.arange(last + 1, scenario.steps + 1)
    rows = [{"depth": depth, "reason": "not made"} for depth in rest]
    more = ShapeLog.from_rows(rows, experiment.true_path)
    arrays = {
        name: np.concatenate([getattr(log, name), getattr(more, name)])
        for name in ShapeLog.__dataclass_fields__
    }
    return ShapeLog(**arrays) if len(rest) else log


def _with(
    log: ShapeLog, experiment: ShapePredictionExperiment, found: Sequence[object]
) -> ShapeLog:
    """Return a log with the cross-sections that another tracker found in the same slices."""
    measured = np.full_like(log.measured, np.nan)
    for number, each in enumerate(found):
        if isinstance(each, CrossSection):
            measured[number] = experiment.X_WP.inverse().multiply(each.position)
    return replace(log, measured=measured)


def _exact(experiment: ShapePredictionExperiment, log: ShapeLog) -> list[CrossSection]:
    """Return the cross-sections that were found, each moved to where the needle really is."""
    exact = []
    for each in experiment.cross_sections:
        depth = experiment.X_WP.inverse().multiply(each.position)[2]
        x, y = (np.interp(depth, log.depth, log.true[:, axis]) for axis in (0, 1))
        exact.append(replace(each, position=experiment.X_WP.multiply([x, y, depth])))
    return exact


def _bound(experiment: ShapePredictionExperiment, log: ShapeLog) -> dict[str, float]:
    """Return the least root mean square error of tip in mm, with the scatter of this needle."""
    scenario, path = experiment.scenario, experiment.insertion.path
    if not isinstance(path, SteeredPath):
        return {}  # the bound is that of the bicycle
    parameters = scenario.particle_filter
    bend = TrueBend(
        radius=path.radius,
        angle=path.angle,
        rotations=path.rotations,
        wander=scenario.hand.curvature_wander,
        wander_length=scenario.hand.wander_length,
        radius_std=parameters.radius_std,
        angle_std=parameters.angle_std,
    )
    used = np.isfinite(log.measured[:, 0])
    used &= log.depth <= (scenario.observe_until or scenario.depth) + 1e-9
    # Median, so that slices in which something else was found do not count.
    apart = np.abs(log.measured[used, :2] - log.true[used, :2])
    noise = 1.4826 * float(np.median(apart))
    least = deflection_bound(bend, log.depth[used], noise, log.depth[1:])
    return {"tip_mm": 1e3 * float(least[-1]), "noise_mm": 1e3 * noise}


def _sweeps(
    experiment: ShapePredictionExperiment, case: Case, slices: Sequence[ImageSlice], log: ShapeLog
) -> Mapping[str, Mapping[str, Any]]:
    """Return the published method's errors with each value of each parameter."""
    results: dict[str, dict[str, Any]] = {}
    for name, values in SWEEPS.items():
        results[name] = {}
        for value, changes in values.items():
            predictor = experiment.make_predictor(_published(experiment, case, changes))
            found, shapes = predict_from_slices(predictor, slices)
            figures: Mapping[str, Any] = {}
            if isinstance(shapes[-1], NeedleShape):
                figures = prediction(_with(log, experiment, found), shapes[-1])
            results[name][value] = {key: figures.get(key) for key in SWEPT_ERRORS}
    return results


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


def _kept(experiment: ShapePredictionExperiment, slices: Sequence[ImageSlice]) -> dict[str, Any]:
    """Return the particles of both filters, and the first slice with the person's click."""
    path, scenario = experiment.insertion.path, experiment.scenario
    assert path is not None
    first = slices[0]
    found = experiment.cross_sections[0]
    return {
        "particles": _particles(experiment, experiment.cross_sections),
        "truth": {"radius_m": path.radius, "angle_deg": float(np.rad2deg(path.angle))},
        "slice": {
            "intensities": first.intensities,
            "origin": first.origin,
            "spacing": first.spacing,
            "centre": found.centre,
            "template": scenario.tracker.template,
        },
    }


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
