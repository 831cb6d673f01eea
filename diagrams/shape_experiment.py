"""Needle shape prediction brought to life: hand, stage, scanner, tracker and estimator."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, System

from sonoservo.diagrams.experiment import connect_by_name
from sonoservo.diagrams.shape_predictor import MakeShapePredictor
from sonoservo.diagrams.shape_scenario import ShapeScenario
from sonoservo.systems.display.world.shape_view import ShapeView
from sonoservo.systems.estimation.shape_estimator import ShapeEstimator
from sonoservo.systems.estimation.shape_filter import ShapeFilter
from sonoservo.systems.estimation.shape_filters import SHAPE_FILTERS
from sonoservo.systems.evaluation.shape_log import ShapeLog
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import OUTER_DIAMETER
from sonoservo.systems.robot.probe_stepper import ProbeStepper
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.simulation.scanner import Scanner
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue
from sonoservo.systems.ultrasound.slice_converter import SliceConverter
from sonoservo.systems.ultrasound.transducer import load_transducer

Floats = NDArray[np.float64]

_INSTANT = 1e-6
"""Time in s between an event and what is looked at just before or after it."""


class ShapeExperiment:
    """A scenario of shape prediction as one diagram, and its simulation.

    .. pydrake_system::

        name: (the scenario's)

    The subsystems are hand, probe_stepper, scanner, slice_converter, shape_predictor and, with a
    Meshcat, shape_view. Every one of their inputs is connected to the
    output that has the same name. W and T are the same but for the tissue's shifts.

    Parameters
    ----------
    scenario
        What is to happen.
    meshcat
        Where to draw, if anywhere.

    Raises
    ------
    ValueError
        If the scenario cannot be carried out; the message names the field.
    """

    def __init__(self, scenario: ShapeScenario, meshcat: Meshcat | None = None) -> None:
        self.scenario = scenario
        tissue_seed, insertion_seed, noise_seed, shift_seed, self._estimator_seed = (
            int(seed) for seed in np.random.SeedSequence(scenario.seed).generate_state(5)
        )
        feed = replace(scenario.feed, depth=scenario.depth)
        hand = replace(scenario.hand, feed=feed, rotations=scenario.rotations)
        self.insertion = Insertion(hand, np.random.default_rng(insertion_seed))
        tissue = replace(load_tissue(scenario.phantom), seed=tissue_seed)
        half = np.array(tissue.size) / 2
        end = hand.entry[0] + scenario.depth + feed.lead
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
            seed=noise_seed,
        )
        geometry = self.scanner.geometry
        events = {"period": scenario.period, "offset": scenario.period + scenario.processing_time}
        self._first = events["offset"]
        self.slice_converter = SliceConverter(geometry=geometry, spacing=scenario.pixel)
        self.shape_predictor = MakeShapePredictor(
            localizer=replace(
                scenario.tracker,
                needle_radius=OUTER_DIAMETER[hand.gauge] / 2,
                decibels_per_level=imaging.dynamic_range_db / 255,
            ),
            shape_filter=self.make_filter(scenario.estimator),
            X_WI=self.X_WP,
            seed=self._estimator_seed,
            **events,
        )
        systems: dict[str, System] = {
            "hand": Hand(insertion=self.insertion),
            "probe_stepper": ProbeStepper(
                X_WP=self.X_WP,
                step=scenario.step,
                period=scenario.period,
                steps=scenario.steps,
                tissue_shift=scenario.tissue_shift,
                seed=shift_seed,
            ),
            "scanner": self.scanner,
            "slice_converter": self.slice_converter,
            "shape_predictor": self.shape_predictor,
        }
        if meshcat is not None:
            systems["shape_view"] = ShapeView(
                meshcat=meshcat, tissue_size=tissue.size, depth=scenario.depth,
                period=scenario.period, offset=self._first + _INSTANT,
            )  # fmt: skip
        builder = DiagramBuilder()
        for name, system in systems.items():
            builder.AddNamedSystem(name, system)
        connect_by_name(builder, list(systems.values()))
        self.diagram = builder.Build()
        self.diagram.set_name(scenario.name)
        self._simulator = Simulator(self.diagram)
        self._rows: list[dict[str, Any]] = []

    def make_filter(self, name: str) -> ShapeFilter:
        """Make one of `SHAPE_FILTERS` with the scenario's parameters."""
        scenario = self.scenario
        plan: dict[str, Any] = {
            "depth": scenario.depth,
            "rotations": scenario.rotations,
            "observe_until": scenario.observe_until,
        }
        return SHAPE_FILTERS[name].make(replace(getattr(scenario, name), **plan))

    def make_estimator(self, name: str) -> ShapeEstimator:
        """Make a shape estimator like the experiment's own, with any of `SHAPE_FILTERS`."""
        return ShapeEstimator(
            shape_filter=self.make_filter(name),
            X_WI=self.X_WP,
            period=self.scenario.period,
            seed=self._estimator_seed,
        )

    def run(
        self,
        after_slice: Callable[[float, CrossSection | NotFound], None] | None = None,
        real_time: bool = False,
    ) -> None:
        """Simulate the whole scenario.

        Parameters
        ----------
        after_slice
            Called after every slice, with the simulated time in s and the cross-section.
        real_time
            Whether to go no faster than real time.
        """
        simulator = self._simulator
        simulator.set_target_realtime_rate(1.0 if real_time else 0.0)
        simulator.Initialize()
        for number in range(self.scenario.steps + 1):
            due = self._first + number * self.scenario.period
            simulator.AdvanceTo(due - _INSTANT)
            found = self._look(number, due)
            if after_slice is not None:
                after_slice(self.time, found)

    @property
    def time(self) -> float:
        """Simulated time so far, in s."""
        return self._simulator.get_context().get_time()

    @property
    def shape(self) -> NeedleShape | NotFound:
        """What the estimator believes now."""
        return self._evaluate(self.shape_predictor, "shape")

    def true_path(self, depths: Floats) -> Floats:
        """Return the (m, 3) true path in the first slice's P, in m, at depths in m."""
        shaft = self.insertion.needle(self.insertion.end).transformed(self.X_WP.inverse()).shaft
        return np.stack([np.interp(depths, shaft[:, 2], axis) for axis in shaft.T], axis=-1)

    def log(self) -> ShapeLog:
        """Return what has been seen so far."""
        return ShapeLog.from_rows(self._rows, self.true_path)

    def _look(self, number: int, due: float) -> CrossSection | NotFound:
        """Track the slice that is due, and note what was found and how long it took.

        The ports are evaluated just before the estimator asks for them; it finds them in the
        cache. In the instant of the event nothing else happens. The time is that of this thread,
        whatever else the machine does.
        """
        self._evaluate(self.slice_converter, "slice")
        clock = [time.thread_time()]
        found = self._evaluate(self.shape_predictor, "cross_section")
        clock.append(time.thread_time())
        self._simulator.AdvanceTo(due + _INSTANT)
        clock.append(time.thread_time())
        shape = self.shape
        row: dict[str, Any] = {
            "depth": number * self.scenario.step,
            "image_s": clock[1] - clock[0],
            "estimate_s": clock[2] - clock[1],
        }
        if isinstance(found, CrossSection):
            row["measured"] = self.X_WP.inverse().multiply(found.position)
            row["correlation"] = found.correlation
            row["cross_section"] = found
        else:
            row["reason"] = found.reason
        if isinstance(shape, NeedleShape):
            mean, covariance = shape.predict([self.scenario.depth])
            row["tip"], row["tip_covariance"] = mean[0], covariance[0]
        self._rows.append(row)
        return found

    @property
    def cross_sections(self) -> list[CrossSection]:
        """All cross-sections found so far, in order of time."""
        return [row["cross_section"] for row in self._rows if "cross_section" in row]

    def _evaluate(self, system: System, port: str) -> Any:
        context = system.GetMyContextFromRoot(self._simulator.get_context())
        return system.GetOutputPort(port).Eval(context)
