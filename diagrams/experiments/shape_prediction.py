"""Shape prediction: the final shape of a bevelled needle is predicted from axial slices."""

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram, System

from sonoservo.diagrams.experiments.experiment import INSTANT, Experiment
from sonoservo.diagrams.experiments.shape_prediction_scenario import (
    SHAPE_FILTERS,
    ShapePredictionScenario,
)
from sonoservo.diagrams.scenario import Scenario, draw_seeds, require_scenario
from sonoservo.diagrams.scene import Scene
from sonoservo.diagrams.shape_predictor import MakeShapePredictor
from sonoservo.systems.display.console.shape_page import ShapePage
from sonoservo.systems.display.shape_view import ShapeScreen, ShapeView
from sonoservo.systems.display.world.shape_world import ShapeWorld
from sonoservo.systems.evaluation.log import Row
from sonoservo.systems.evaluation.shape.shape_metrics import ShapeLog, summarize_shape
from sonoservo.systems.evaluation.shape.shape_plots import SlicePicture, picture_slice
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import OUTER_DIAMETER
from sonoservo.systems.robot.probe_stepper import ProbeStepper
from sonoservo.systems.shape.shape_estimator import ShapeEstimator
from sonoservo.systems.shape.shape_filter import ShapeFilter
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.slice_converter import SliceConverter

if TYPE_CHECKING:
    from sonoservo.systems.display.console.console import Console

Floats = NDArray[np.float64]


class ShapePredictionExperiment(Experiment[ShapePredictionScenario]):
    """Diagram of a hand, a probe that steps along the needle, a tracker and a shape estimator.

    .. pydrake_system::

        name: (the scenario's)

    W and T are the same except for the tissue's shifts. Computing times are processor times.

    Parameters
    ----------
    scenario
        Scenario of shape prediction.
    meshcat, console
        Meshcat that draws the run, and console that shows it, if any.
    pictures
        Whether to keep pictures of the slices.
    """

    scenario_class = ShapePredictionScenario
    log_class = ShapeLog
    options = frozenset({"console", "meshcat", "pictures"})

    def __init__(
        self,
        scenario: Scenario,
        meshcat: Meshcat | None = None,
        *,
        console: "Console | None" = None,
        pictures: bool = False,
    ) -> None:
        self._pictured = pictures
        self.scenario = scenario = require_scenario(scenario, ShapePredictionScenario)
        seeds = draw_seeds(scenario)
        self._estimator_seed = seeds.tracker
        feed = replace(scenario.feed, depth=scenario.depth)
        hand = replace(scenario.hand, feed=feed, rotations=scenario.rotations)
        self.insertion = Insertion(hand, np.random.default_rng(seeds.insertion))
        imaging = replace(scenario.imaging, volume_rate=1 / scenario.period, frames=1)
        scene = Scene.of(scenario, self.insertion, imaging=imaging)
        tissue, geometry = scene.tissue, scene.geometry
        half = np.array(tissue.size) / 2
        X_TI = self.insertion.X_TI
        x, y, _ = X_TI.translation()
        end = x + scenario.depth + feed.lead
        require(
            -half[0] <= x and end <= half[0],
            "depth",
            scenario.depth,
            f"such that the insertion, from x = {x:g} to {end:g} m, stays in the "
            f"phantom, {-half[0]:g} to {half[0]:g} m",
        )
        self.X_WP = RigidTransform(X_TI.rotation(), [x, y, scenario.face])
        self.scanner = scene.scanner()
        events = {"period": scenario.period, "offset": scenario.period + scenario.processing_time}
        self.slice_converter = SliceConverter(geometry=geometry, spacing=scenario.pixel)
        # A person points at the needle; neither tracker nor estimator see where it truly is.
        rng = np.random.default_rng([seeds.insertion, 1])
        self._click = self.true_path(np.zeros(1))[0, :2] + (scenario.click_std or 0.0) * rng.normal(
            size=2
        )
        self.shape_predictor = self.make_predictor(scenario)
        systems: dict[str, System] = {
            "hand": Hand(insertion=self.insertion),
            "probe_stepper": ProbeStepper(
                X_WP=self.X_WP,
                step=scenario.step,
                period=scenario.period,
                steps=scenario.steps,
                tissue_shift=scenario.tissue_shift,
                breathing=scenario.breathing,
                breathing_period=scenario.breathing_period,
                seed=seeds.station,
            ),
            "scanner": self.scanner,
            "slice_converter": self.slice_converter,
            "shape_predictor": self.shape_predictor,
        }
        screens: list[ShapeScreen] = []
        if meshcat is not None:
            world = ShapeWorld(
                meshcat=meshcat, tissue_size=tissue.size, depth=scenario.depth, geometry=geometry
            )
            screens.append(world)
        if console is not None:
            screens.append(ShapePage(console=console, depth=scenario.depth))
        if screens:
            a_moment_later = {"period": scenario.period, "offset": events["offset"] + INSTANT}
            systems["shape_view"] = ShapeView(screens=screens, **a_moment_later)
        super().__init__(
            scenario,
            systems,
            period=events["period"],
            offset=events["offset"],
            stages={
                "slice": (self.slice_converter, "slice"),
                "image": (self.shape_predictor, "cross_section"),
            },
            event="estimate",
            clock=time.thread_time,
            optional=("deformation", "true_X_WP"),
            sees_truth=("scanner", "shape_view"),
        )

    def make_predictor(self, scenario: ShapePredictionScenario) -> Diagram:
        """Make a shape predictor for this needle, with the tracker and estimator of a scenario."""
        tracker = replace(
            scenario.tracker, needle_radius=OUTER_DIAMETER[self.insertion.parameters.gauge] / 2
        )
        if scenario.click_std is not None and tracker.start is None:
            tracker = replace(tracker, start=self._click.tolist())
        return MakeShapePredictor(
            localizer=tracker,
            shape_filter=self.make_filter(scenario.estimator, scenario),
            X_WI=self.X_WP,
            seed=self._estimator_seed,
            period=self.scenario.period,
            offset=self.scenario.period + self.scenario.processing_time,
        )

    def make_filter(
        self, name: str, scenario: ShapePredictionScenario | None = None
    ) -> ShapeFilter:
        """Make one of `SHAPE_FILTERS` with the parameters of a scenario, by default its own."""
        scenario = scenario or self.scenario
        plan: dict[str, Any] = {
            "depth": scenario.depth,
            "rotations": scenario.rotations,
            "observe_until": scenario.observe_until,
        }
        return SHAPE_FILTERS[name].make(replace(getattr(scenario, name), **plan))

    def make_estimator(
        self, name: str, scenario: ShapePredictionScenario | None = None
    ) -> ShapeEstimator:
        """Make a shape estimator for this needle, with a filter as from `make_filter`."""
        return ShapeEstimator(
            shape_filter=self.make_filter(name, scenario),
            X_WI=self.X_WP,
            period=self.scenario.period,
            seed=self._estimator_seed,
        )

    @property
    def shape(self) -> NeedleShape | NotFound:
        """Present prediction of the needle's shape."""
        return cast(NeedleShape | NotFound, self.evaluate(self.shape_predictor, "shape"))

    def true_path(self, depths: Floats) -> Floats:
        """Return the (m, 3) true path in the first slice's P, in m, at depths in m."""
        shaft = self.insertion.needle(self.insertion.end).transformed(self.X_WP.inverse()).shaft
        return np.stack([np.interp(depths, shaft[:, 2], axis) for axis in shaft.T], axis=-1)

    @property
    def status(self) -> str:
        """Result of the search in the newest slice."""
        return "following" if self._rows and "cross_section" in self._rows[-1] else "not found"

    @property
    def cross_sections(self) -> list[CrossSection]:
        """All cross-sections found so far, in order of time."""
        return [row["cross_section"] for row in self._rows if "cross_section" in row]

    def log(self) -> ShapeLog:
        """Return the log so far."""
        return ShapeLog.from_rows(self._rows, self.true_path)

    def results(self) -> dict[str, Any]:
        """Return `shape`, the estimator's final prediction."""
        return {"shape": self.shape}

    def summarize(self, log: ShapeLog) -> dict[str, Any]:
        """Summarise a log and the shape; see `summarize_shape`."""
        return {"estimator": self.scenario.estimator, **summarize_shape(log, self.shape)}

    @property
    def slice_pictures(self) -> list[SlicePicture]:
        """Pictures of the slices so far; none unless they are kept."""
        return self._pictures

    def _begin(self) -> None:
        super()._begin()
        self._rows: list[Row] = []
        self._pictures: list[SlicePicture] = []

    def _after_step(self, number: int) -> None:
        """Record the result of a slice, and its computing time."""
        found = self.evaluate(self.shape_predictor, "cross_section")
        # A slice that comes late was acquired in an earlier step.
        acquired = self.evaluate(self.scanner, "motion_record").true.time
        row: Row = {"depth": round(acquired / self.scenario.period) * self.scenario.step}
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
        image = self.evaluate(self.slice_converter, "slice")
        if self._pictured and isinstance(image, ImageSlice):
            (middle,) = self.true_path(np.array([row["depth"]]))
            self._pictures.append(picture_slice(image, row["depth"], middle[:2]))
