"""A scene in which the probe moves as planned, and several trackers see the same volumes."""

from collections.abc import Sequence

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, System

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import (
    imaging_systems,
    make_scene,
    observer_events,
    tracker_events,
)
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.scenario import draw_seeds
from sonoservo.diagrams.studies.robustness.planned_motion import MotionPlan, PlannedMotion
from sonoservo.diagrams.tracker_bench import MakeTrackerBench, log_of
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.diagrams.wiring import connect_by_name
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.recording.volume_collector import VolumeCollector
from sonoservo.systems.robot.errors.calibration import hand_eye_error
from sonoservo.systems.robot.errors.pose_delay import PoseDelay
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.volume import Volume

_OBSERVED = ("X_WP", "true_X_WP", "X_WT", "needle", "motion_record")


def make_bench(
    scenario: FollowingScenario,
    geometry: SweepGeometry,
    tracker: str,
    *,
    correct_poses: bool = False,
) -> Diagram:
    """Make a bench that observes the volumes of a scenario with a tracker, by its kind.

    The tracker has its default parameters; only its log reads the truth.
    """
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
    """Acquire a scenario's volumes with a probe that is moved as planned, and track in them.

    Every tracker gets the same volumes with the same poses; none of them moves the probe.
    """
    scene = make_scene(scenario)
    benches = {
        each: make_bench(scenario, scene.geometry, each, correct_poses=correct_poses)
        for each in trackers
    }
    collector = VolumeCollector(**observer_events(scenario))
    observers: dict[str, System] = {**benches, "volume_collector": collector}
    systems: dict[str, System] = {
        "measured_motion": MakeMeasuredMotion(
            scenario=scenario, plan=MotionPlan(scenario, scene.insertion)
        ),
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
        optional=("deformation",),
        sees_truth={"hand", "scanner", *observers},
    )
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    simulator.AdvanceTo(scenario.duration)
    context = simulator.get_context()
    logs = {
        name: log_of(each, each.GetMyContextFromRoot(context)) for name, each in benches.items()
    }
    return logs, collector.volumes(collector.GetMyContextFromRoot(context))


def MakeMeasuredMotion(*, scenario: FollowingScenario, plan: MotionPlan) -> Diagram:
    """Make a planned motion with the probe's measured pose: late, and calibrated wrongly.

    .. pydrake_system::

        name: (none)
        output_ports:
        - X_WP
        - true_X_WP
        - X_WT
    """
    seeds, station = draw_seeds(scenario), scenario.station
    builder = DiagramBuilder()
    motion = builder.AddNamedSystem(
        "planned_motion",
        PlannedMotion(
            plan=plan,
            X_PC=hand_eye_error(station.calibration, seeds.station),
        ),
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
