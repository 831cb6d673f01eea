"""Shape prediction: how a bevelled needle will lie is predicted from axial slices."""

import time
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import System

from sonoservo.diagrams.experiments.experiment import INSTANT, Experiment
from sonoservo.diagrams.experiments.shape_prediction_scenario import ShapePredictionScenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.diagrams.seeds import draw_seeds
from sonoservo.systems.display.world.shape_view import ShapeView
from sonoservo.systems.estimation.least_squares_shape_estimator import LeastSquaresShapeEstimator
from sonoservo.systems.estimation.particle_shape_estimator import ParticleShapeEstimator
from sonoservo.systems.estimation.published_shape_estimator import PublishedShapeEstimator
from sonoservo.systems.estimation.shape_estimator import ShapeEstimator
from sonoservo.systems.evaluation.log import Row
from sonoservo.systems.evaluation.shape_log import ShapeLog
from sonoservo.systems.evaluation.shape_metrics import LABELS, summarize_shape
from sonoservo.systems.evaluation.shape_plots import plot_shape
from sonoservo.systems.localization.cross_section_tracker import CrossSectionTracker
from sonoservo.systems.needle.bevelled_insertion import BevelledInsertion
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import OUTER_DIAMETER
from sonoservo.systems.robot.probe_stepper import ProbeStepper
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.simulation.scanner import Scanner
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue
from sonoservo.systems.ultrasound.slice_converter import SliceConverter
from sonoservo.systems.ultrasound.transducer import load_transducer


class ShapePredictionExperiment(Experiment[ShapePredictionScenario]):
    """A hand, a probe that steps along the needle, a tracker and a shape estimator.

    .. pydrake_system::

        name: (the scenario's)

    The subsystems are hand, probe_stepper, scanner, slice_converter, cross_section_tracker,
    shape_estimator and, with a Meshcat, shape_view. W and T are the same but for the tissue's
    shifts. Computing times are those of this thread, whatever else the machine does.

    Parameters
    ----------
    scenario
        Scenario of shape prediction.
    meshcat
        Meshcat that draws the run, if any.

    Raises
    ------
    ValueError
        If the scenario cannot be carried out; the message names the field.
    """

    scenario_class = ShapePredictionScenario
    labels = LABELS

    def __init__(self, scenario: Scenario, meshcat: Meshcat | None = None) -> None:
        self.scenario = scenario = require_scenario(scenario, ShapePredictionScenario)
        seeds = draw_seeds(scenario)
        self._estimator_seed = seeds.tracker
        hand = replace(scenario.hand, depth=scenario.depth, rotations=scenario.rotations)
        self.insertion = BevelledInsertion(hand, np.random.default_rng(seeds.insertion))
        tissue = replace(load_tissue(scenario.phantom), seed=seeds.tissue)
        half = np.array(tissue.size) / 2
        end = hand.entry[0] + scenario.depth + hand.lead
        require(
            -half[0] <= hand.entry[0] and end <= half[0],
            "depth",
            scenario.depth,
            f"such that the insertion, from x = {hand.entry[0]:g} to {end:g} m, stays in the "
            f"phantom, {-half[0]:g} to {half[0]:g} m",
        )
        X_TI = self.insertion.X_TI
        x, y, _ = X_TI.translation()
        self.X_WP = RigidTransform(X_TI.rotation(), [x, y, scenario.face])
        imaging = replace(scenario.imaging, volume_rate=1 / scenario.period, frames=1)
        self.scanner = Scanner(
            transducer=load_transducer(scenario.transducer),
            imaging=imaging,
            tissue=tissue,
            parameters=scenario.scanner,
            seed=seeds.noise,
        )
        geometry = self.scanner.geometry
        events = {"period": scenario.period, "offset": scenario.period + scenario.processing_time}
        self.slice_converter = SliceConverter(geometry=geometry, spacing=scenario.pixel)
        self.cross_section_tracker = CrossSectionTracker(
            parameters=replace(
                scenario.tracker,
                needle_radius=OUTER_DIAMETER[hand.gauge] / 2,
                decibels_per_level=imaging.dynamic_range_db / 255,
            ),
            **events,
        )
        self.shape_estimator = self.make_estimator(scenario.estimator)
        systems: dict[str, System] = {
            "hand": Hand(insertion=self.insertion),
            "probe_stepper": ProbeStepper(
                X_WP=self.X_WP,
                step=scenario.step,
                period=scenario.period,
                steps=scenario.steps,
                tissue_shift=scenario.tissue_shift,
                seed=seeds.station,
            ),
            "scanner": self.scanner,
            "slice_converter": self.slice_converter,
            "cross_section_tracker": self.cross_section_tracker,
            "shape_estimator": self.shape_estimator,
        }
        if meshcat is not None:
            systems["shape_view"] = ShapeView(
                meshcat=meshcat, tissue_size=tissue.size, depth=scenario.depth,
                period=scenario.period, offset=events["offset"] + INSTANT,
            )  # fmt: skip
        super().__init__(
            scenario,
            systems,
            period=events["period"],
            offset=events["offset"],
            stages={
                "slice": (self.slice_converter, "slice"),
                "image": (self.cross_section_tracker, "cross_section"),
            },
            event="estimate",
            clock=time.thread_time,
            sees_truth=("scanner", "shape_view"),
        )

    def make_estimator(self, name: str) -> ShapeEstimator:
        """Make one of the scenario's shape estimators; see `ShapePredictionScenario.estimator`."""
        scenario = self.scenario
        events = {"period": scenario.period, "offset": scenario.period + scenario.processing_time}
        plan: dict[str, Any] = {
            "depth": scenario.depth,
            "rotations": scenario.rotations,
            "observe_until": scenario.observe_until,
        }
        common: dict[str, Any] = {
            **events,
            "X_WI": self.X_WP,
            "seed": self._estimator_seed,
        }
        if name == "particle_filter":
            return ParticleShapeEstimator(
                parameters=replace(scenario.particle_filter, **plan), **common
            )
        if name == "least_squares":
            return LeastSquaresShapeEstimator(
                parameters=replace(scenario.least_squares, **plan), **common
            )
        return PublishedShapeEstimator(parameters=replace(scenario.published, **plan), **common)

    @property
    def shape(self) -> NeedleShape | NotFound:
        """Shape that the estimator expects now."""
        return cast(NeedleShape | NotFound, self.evaluate(self.shape_estimator, "shape"))

    def true_path(self, depths: Iterable[float]) -> Any:
        """(m, 3) true path in the first slice's P, in m, at depths in m."""
        X_PI = self.X_WP.InvertAndCompose(self.insertion.X_TI)
        return X_PI.multiply(self.insertion.position(np.asarray(depths, dtype=float)).T).T

    @property
    def status(self) -> str:
        """What became of the newest slice."""
        return "following" if self._rows and "cross_section" in self._rows[-1] else "not found"

    @property
    def cross_sections(self) -> list[CrossSection]:
        """All cross-sections found so far, in order of time."""
        return [row["cross_section"] for row in self._rows if "cross_section" in row]

    def log(self) -> ShapeLog:
        """Return what has been seen so far."""
        return ShapeLog.from_rows(self._rows, self.true_path)

    def results(self) -> dict[str, Any]:
        """Return `shape`, which the estimator believes at the end."""
        return {"shape": self.shape}

    def summarize(self, log: ShapeLog) -> dict[str, Any]:
        """Sum up a log and the shape, see `summarize_shape`."""
        return {"estimator": self.scenario.estimator, **summarize_shape(log, self.shape)}

    def plots(self, log: ShapeLog) -> dict[str, tuple[str, Figure]]:
        """Return the plot of the paths, if there are any."""
        if len(log.depth) < 2:
            return {}
        return {"shape.png": ("path, measured, true and predicted", plot_shape(log, self.shape))}

    def _begin(self) -> None:
        super()._begin()
        self._rows: list[Row] = []

    def _after_step(self, number: int) -> None:
        """Note what was found in a slice, and how long it took."""
        found = self.evaluate(self.cross_section_tracker, "cross_section")
        row: Row = {"depth": number * self.scenario.step}
        row |= {f"{name}_s": self.compute[name][-1] for name in ("image", "estimate")}
        if isinstance(found, CrossSection):
            row["measured"] = self.X_WP.inverse().multiply(found.position)
            row["correlation"] = found.correlation
            row["cross_section"] = found
        else:
            row["reason"] = found.reason
        shape = self.shape
        if isinstance(shape, NeedleShape):
            mean, covariance = shape.predict([self.scenario.depth])
            row["tip"], row["tip_covariance"] = mean[0], covariance[0]
        self._rows.append(row)


def estimate_shape(
    estimator: ShapeEstimator, cross_sections: Iterable[CrossSection]
) -> list[NeedleShape | NotFound]:
    """Estimate a needle's shape from recorded cross-sections, without a simulation.

    Returns
    -------
    The shape after each cross-section.
    """
    # No event is ever due: one is forced for each cross-section.
    context = estimator.CreateDefaultContext()
    shapes: list[NeedleShape | NotFound] = []
    for each in cross_sections:
        estimator.GetInputPort("cross_section").FixValue(context, Value[object](each))
        estimator.ExecuteForcedEvents(context)
        shape: Any = estimator.GetOutputPort("shape").Eval(context)
        shapes.append(shape)
    return shapes
