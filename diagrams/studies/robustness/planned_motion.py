"""Leaf system that moves probe and phantom as planned, in place of a robot."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, LeafSystem, System
from pydrake.trajectories import Trajectory

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import (
    imaging_systems,
    make_scene,
    observer_events,
    tracker_events,
)
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.scenario import draw_seeds
from sonoservo.diagrams.scene import Scene
from sonoservo.diagrams.tracker_bench import MakeTrackerBench, log_of
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.diagrams.wiring import connect_by_name
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.recording.volume_collector import VolumeCollector
from sonoservo.systems.robot.errors.calibration import hand_eye_error
from sonoservo.systems.robot.errors.pose_delay import PoseDelay
from sonoservo.systems.robot.phantom_motion import phantom_trajectory
from sonoservo.systems.signals.body_surface import BodySurface
from sonoservo.systems.signals.ports import DiagramBuilder, declare_output
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue

_INDENTATION = 4e-3  # indentation of the phantom by the probe, in m, as with a force of 2 N

_APPROACH = 3.0
"""Time in s in which the probe comes over the needle's tip and turns to its direction."""

_STEEPEST = np.deg2rad(80)
"""Angle below the horizontal above which the probe does not turn to a needle, in rad."""


@dataclass(frozen=True)
class MotionPlan:
    """Poses of probe and phantom over time, planned from where the needle will be.

    The probe rests during the first push, so that every tracker meets the needle at rest, comes
    over the tip in 3 s, turns its image to the needle, and follows. It rides on the phantom as it
    breathes.
    """

    scenario: FollowingScenario
    insertion: Insertion

    def phantom(self, time: float) -> RigidTransform:
        """Return the pose X_WT of the phantom."""
        pose = self._trajectory.value(max(time, 0.0))[:, 0]
        return RigidTransform(RollPitchYaw(pose[3:]), pose[:3])

    def probe(self, time: float) -> RigidTransform:
        """Return the true pose X_WP of the probe."""
        at_rest = self._over(time)
        breath = self.scenario.phantom_motion.breathing.displacement(max(time, 0.0))
        normal = at_rest.rotation().matrix()[:, 1]
        return RigidTransform(normal * (normal @ breath)) @ at_rest

    @property
    def begin(self) -> float:
        """Time in s at which the first push is over and the probe begins to follow the needle."""
        hand = self.insertion.parameters
        return (hand.start or 0.0) + sum(push.duration for push in hand.pushes[:1])

    def _over(self, time: float) -> RigidTransform:
        """Return the pose of the probe on a phantom that does not breathe."""
        share = float(np.clip((time - self.begin) / _APPROACH, 0, 1))
        if share == 0:
            return self._placed(None)
        needle, start = self.insertion.needle(time), self.scenario.station.probe
        if not needle:
            return self._placed(None)
        share *= share * (3 - 2 * share)
        direction = needle.curve.direction
        yaw = start.yaw_deg
        if -np.arcsin(direction[2]) < _STEEPEST:
            # The needle's axis has no sense, so the probe turns to it the shorter way.
            turn = np.rad2deg(np.arctan2(direction[1], direction[0])) - yaw
            yaw += share * ((turn + 90) % 180 - 90)
        x, y = (1 - share) * np.array([start.x, start.y]) + share * needle.tip[:2]
        return self._placed((float(x), float(y), float(yaw)))

    def _placed(self, place: tuple[float, float, float] | None) -> RigidTransform:
        x, y, yaw_deg = place or (None, None, None)
        return self.scenario.station.probe_pose(
            x=x, y=y, yaw_deg=yaw_deg, height=-_INDENTATION, surface=self._surface
        )

    @cached_property
    def _trajectory(self) -> Trajectory:
        return phantom_trajectory(self.scenario.phantom_motion, self.scenario.station.X_WT)

    @cached_property
    def _surface(self) -> BodySurface:
        return load_tissue(self.scenario.phantom).surface


class PlannedMotion(LeafSystem):
    """Outputs the poses of probe and phantom that a plan gives, as functions of time alone."""

    def __init__(self, *, plan: MotionPlan, X_PC: RigidTransform) -> None:
        super().__init__()
        self._plan, self._X_PC = plan, X_PC
        for name, pose in (
            ("true_X_WP", plan.probe),
            ("X_WT", plan.phantom),
            ("calibrated_X_WP", self._calibrated),
        ):
            declare_output(
                self,
                name,
                RigidTransform,
                partial(self._set_pose, pose),
                {self.time_ticket()},
            )

    @staticmethod
    def _set_pose(
        pose: Callable[[float], RigidTransform], context: Context, output: AbstractValue
    ) -> None:
        output.set_value(pose(context.get_time()))

    def _calibrated(self, time: float) -> RigidTransform:
        return self._plan.probe(time) @ self._X_PC


_OBSERVED = ("X_WP", "true_X_WP", "X_WT", "needle", "motion_record")


def make_bench(
    scenario: FollowingScenario,
    geometry: SweepGeometry,
    tracker: str,
    *,
    correct_poses: bool = False,
) -> Diagram:
    """Make a bench that observes the volumes of a scenario with a tracker, by its kind."""
    kind, looks = next(each for each in TRACKERS if each.kind == tracker), observer_events(scenario)
    return MakeTrackerBench(
        tracker=MakeNeedleTracker(
            parameters=kind(),
            seed=draw_seeds(scenario).tracker,
            correct_poses=correct_poses,
            **tracker_events(scenario),
        ),
        observed=_OBSERVED,
        geometry=geometry,
        period=looks["period"],
        offset=looks["offset"],
    )


def run_open_loop(
    scenario: FollowingScenario, trackers: Sequence[str], *, correct_poses: bool = False
) -> tuple[dict[str, RunLog], list[Volume]]:
    """Acquire the volumes of a probe that is moved as planned, and track in them with each."""
    scene = make_scene(scenario)
    benches = {
        each: make_bench(scenario, scene.geometry, each, correct_poses=correct_poses)
        for each in trackers
    }
    collector = VolumeCollector(**observer_events(scenario))
    simulator = simulate_planned(
        scenario,
        scene,
        MotionPlan(scenario, scene.insertion),
        {**benches, "volume_collector": collector},
        until=scenario.duration,
    )
    context = simulator.get_context()
    logs = {
        name: log_of(each, each.GetMyContextFromRoot(context)) for name, each in benches.items()
    }
    return logs, collector.volumes(collector.GetMyContextFromRoot(context))


def simulate_planned(
    scenario: FollowingScenario,
    scene: Scene,
    plan: MotionPlan,
    observers: Mapping[str, System],
    *,
    until: float,
    optional: Iterable[str] = (),
) -> Simulator:
    """Simulate a probe that moves as planned up to a time in s, and return the simulator."""
    systems: dict[str, System] = {
        "measured_motion": MakeMeasuredMotion(scenario=scenario, plan=plan),
        **scene.reacting({"hand": Hand(insertion=scene.insertion)}),
        **imaging_systems(scenario, scene),
        **observers,
    }
    builder = DiagramBuilder()
    for name, system in systems.items():
        builder.AddNamedSystem(name, system)
    connect_by_name(
        builder,
        systems,
        optional={"deformation", *optional},
        sees_truth={"hand", "scanner", *observers},
    )
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(until)
    return simulator


def MakeMeasuredMotion(*, scenario: FollowingScenario, plan: MotionPlan) -> Diagram:
    """Make a planned motion with the probe's measured pose: late, and calibrated wrongly."""
    seeds, station = draw_seeds(scenario), scenario.station
    builder = DiagramBuilder()
    motion = builder.AddNamedSystem(
        "planned_motion",
        PlannedMotion(plan=plan, X_PC=hand_eye_error(station.calibration, seeds.station)),
    )
    delay = builder.AddNamedSystem(
        "pose_delay",
        PoseDelay(
            parameters=station.pose_delay, period=station.plant.time_step, seed=seeds.station
        ),
    )
    builder.Connect(motion.GetOutputPort("calibrated_X_WP"), delay.GetInputPort("pose"))
    builder.ExportOutput(delay.GetOutputPort("delayed_pose"), "X_WP")
    for port in ("true_X_WP", "X_WT"):
        builder.ExportOutput(motion.GetOutputPort(port), port)
    return builder.Build()
