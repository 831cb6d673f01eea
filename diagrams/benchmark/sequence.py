"""Sequence of the benchmark: volumes of a planned motion with a forced loss, and the truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, System

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import (
    imaging_systems,
    make_scene,
    observer_events,
)
from sonoservo.diagrams.scenario import draw_seeds
from sonoservo.diagrams.studies.robustness.graded_dials import scenario_of
from sonoservo.diagrams.studies.robustness.open_loop import MakeMeasuredMotion
from sonoservo.diagrams.studies.robustness.planned_motion import MotionPlan
from sonoservo.diagrams.wiring import connect_by_name
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.recording.volume_collector import VolumeCollector
from sonoservo.systems.signals.volume import Volume

_BEFORE, _LIFTED, _AFTER = 5.0, 2.0, 4.0
"""Times in s from the first push's end to the forced loss, of the loss, and after it."""

_LIFT, _RAMP = 0.015, 0.4
"""Height of the lifted probe over where it rode, in m, and time of lifting it, in s."""


@dataclass(frozen=True)
class LiftedPlan(MotionPlan):
    """Planned motion with a forced loss: for two seconds the probe is off the skin."""

    @property
    def lifted(self) -> tuple[float, float]:
        """Times in s between which the probe is on its way up, off the skin or on its way down."""
        begin = self.begin if self.begin < self.scenario.duration else 8.25
        return begin + _BEFORE, begin + _BEFORE + _LIFTED

    def probe(self, time: float) -> RigidTransform:
        """Return the true pose X_WP of the probe."""
        up, down = self.lifted
        height = _LIFT * float(np.clip(min(time - up, down - time) / _RAMP, 0, 1))
        return super().probe(time) @ RigidTransform([0, -height, 0])


@dataclass(frozen=True, eq=False)
class Sequence:
    """Volumes of a sequence in order of time, with the poses as measured, and the truth."""

    volumes: list[Volume]
    truth: RunLog  # log of the run without estimates
    lifted: tuple[float, float]  # between which the probe is lifted, in s
    tracker_seed: int  # for the random choices of a tracker
    needle_radius: float  # in m


def acquire_sequence(settings: Mapping[str, Any], seed: int) -> Sequence:
    """Simulate a sequence of a suite, given its `Suite.settings` and a seed."""
    with scenario_of(settings, seed) as scenario:
        return _acquire(scenario)


def _acquire(scenario: FollowingScenario) -> Sequence:
    scene, looks = make_scene(scenario), observer_events(scenario)
    plan = LiftedPlan(scenario, scene.insertion)
    logger = RunLogger(geometry=scene.geometry)
    collector = VolumeCollector(**looks)
    systems: dict[str, System] = {
        "measured_motion": MakeMeasuredMotion(scenario=scenario, plan=plan),
        **scene.reacting({"hand": Hand(insertion=scene.insertion)}),
        **imaging_systems(scenario, scene),
        "volume_collector": collector,
        "run_logger": logger,
    }
    builder = DiagramBuilder()
    for name, system in systems.items():
        builder.AddNamedSystem(name, system)
    unlogged = {logger.get_input_port(k).get_name() for k in range(logger.num_input_ports())}
    connect_by_name(
        builder,
        systems,
        optional={"deformation", *unlogged},
        sees_truth={"hand", "scanner", "run_logger"},
    )
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(plan.lifted[1] + _AFTER)
    context = simulator.get_context()
    return Sequence(
        volumes=collector.volumes(collector.GetMyContextFromRoot(context)),
        truth=logger.log(logger.GetMyContextFromRoot(context)),
        lifted=plan.lifted,
        tracker_seed=draw_seeds(scenario).tracker,
        needle_radius=scene.insertion.needle(0.0).radius,
    )
