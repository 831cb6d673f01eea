"""Needle shape prediction brought to life: hand, stage, scanner, tracker and estimator."""

import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, System

from sonoservo.diagrams.experiment import connect_by_name
from sonoservo.diagrams.shape_scenario import ShapeScenario
from sonoservo.systems.display.world.shape_view import ShapeView
from sonoservo.systems.estimation.least_squares_shape_estimator import LeastSquaresShapeEstimator
from sonoservo.systems.estimation.particle_shape_estimator import ParticleShapeEstimator
from sonoservo.systems.estimation.published_shape_estimator import PublishedShapeEstimator
from sonoservo.systems.estimation.shape_estimator import ShapeEstimator
from sonoservo.systems.evaluation.shape_log import ShapeLog
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

_INSTANT = 1e-6
"""Time in s between an event and what is looked at just before or after it."""


class ShapeExperiment:
    """A scenario of shape prediction as one diagram, and its simulation.

    .. pydrake_system::

        name: (the scenario's)

    The subsystems are hand, probe_stepper, scanner, slice_converter, cross_section_tracker,
    shape_estimator and, with a Meshcat, shape_view. Every one of their inputs is connected to the
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
        hand = replace(scenario.hand, depth=scenario.depth, rotations=scenario.rotations)
        self.insertion = BevelledInsertion(hand, np.random.default_rng(insertion_seed))
        tissue = replace(load_tissue(scenario.phantom), seed=tissue_seed)
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
            seed=noise_seed,
        )
        geometry = self.scanner.geometry
        events = {"period": scenario.period, "offset": scenario.period + scenario.processing_time}
        self._first = events["offset"]
        self.slice_converter = SliceConverter(geometry=geometry, spacing=scenario.pixel)
        self.cross_section_tracker = CrossSectionTracker(
            parameters=replace(scenario.tracker, needle_radius=OUTER_DIAMETER[hand.gauge] / 2),
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
                seed=shift_seed,
            ),
            "scanner": self.scanner,
            "slice_converter": self.slice_converter,
            "cross_section_tracker": self.cross_section_tracker,
            "shape_estimator": self.shape_estimator,
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

    def make_estimator(self, name: str) -> ShapeEstimator:
        """Make one of the scenario's shape estimators; see `ShapeScenario.estimator`."""
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
        return self._evaluate(self.shape_estimator, "shape")

    def true_path(self, depths: Iterable[float]) -> Any:
        """(m, 3) true path in the first slice's P, in m, at depths in m."""
        X_PI = self.X_WP.InvertAndCompose(self.insertion.X_TI)
        return X_PI.multiply(self.insertion.position(np.asarray(depths, dtype=float)).T).T

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
        found = self._evaluate(self.cross_section_tracker, "cross_section")
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
