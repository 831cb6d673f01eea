"""A scene in which the probe moves as planned, and several trackers see the same volumes."""

from collections.abc import Sequence

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder, System

from sonoservo.diagrams.experiments.following_events import is_irregular, observer_events
from sonoservo.diagrams.experiments.following_insertion import (
    check_beside_probe,
    check_entry,
    make_insertion,
)
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_tissue import with_tissue_reaction
from sonoservo.diagrams.seeds import draw_seeds, make_tissue
from sonoservo.diagrams.studies.robustness.logged_tracker import MakeLoggedTracker, log_of
from sonoservo.diagrams.studies.robustness.planned_motion import MotionPlan, PlannedMotion
from sonoservo.diagrams.wiring import connect_by_name
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.needle.hand import Hand
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.recording.volume_collector import VolumeCollector
from sonoservo.systems.robot.errors.calibration import hand_eye_error
from sonoservo.systems.robot.errors.pose_delay import PoseDelay
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.scan_converter import ScanConverter
from sonoservo.systems.ultrasound.simulation.scanner import Scanner
from sonoservo.systems.ultrasound.transducer import load_transducer


def run_open_loop(
    scenario: FollowingScenario, trackers: Sequence[str], *, correct_poses: bool = False
) -> tuple[dict[str, RunLog], list[Volume]]:
    """Acquire a scenario's volumes with a probe that is moved as planned, and track in them.

    Every tracker gets the same volumes with the same poses; none of them moves the probe.

    Parameters
    ----------
    scenario
        Scenario of following, of which the controller and the arm play no part.
    trackers
        Kinds of the trackers.
    correct_poses
        Whether each tracker corrects the poses of its volumes first.

    Returns
    -------
    Log of each tracker, by its kind, and the volumes.
    """
    observers = {
        each: MakeLoggedTracker(scenario=scenario, tracker=each, correct_poses=correct_poses)
        for each in trackers
    }
    collector = VolumeCollector(**observer_events(scenario))
    diagram = _make_scene(scenario, {**observers, "volume_collector": collector})
    simulator = Simulator(diagram)
    simulator.Initialize()
    simulator.AdvanceTo(scenario.duration)
    context = simulator.get_context()
    logs = {
        name: log_of(each, each.GetMyContextFromRoot(context)) for name, each in observers.items()
    }
    return logs, collector.volumes(collector.GetMyContextFromRoot(context))


def _make_scene(scenario: FollowingScenario, observers: dict[str, System]) -> Diagram:
    """Return the diagram of planned motion, needle, scanner and observers."""
    seeds, transducer = draw_seeds(scenario), load_transducer(scenario.probe)
    insertion = make_insertion(scenario)
    tissue = make_tissue(scenario, scenario.phantom, insertion)
    check_entry(scenario, tissue.surface)
    check_beside_probe(scenario, insertion, tissue.surface)
    geometry = sweep_geometry(transducer, scenario.imaging)
    sources: dict[str, System] = {"hand": Hand(insertion=insertion)}
    systems: dict[str, System] = {
        "measured_motion": _make_measured_motion(scenario, insertion),
        **with_tissue_reaction(scenario, sources),
        "scanner": Scanner(
            transducer=transducer,
            imaging=scenario.imaging,
            tissue=tissue,
            parameters=scenario.scanner,
            seed=seeds.noise,
            processing_time=scenario.processing_time if is_irregular(scenario, geometry) else 0.0,
        ),
        "scan_converter": ScanConverter(geometry=geometry, parameters=scenario.scan_conversion),
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
    return builder.Build()


def _make_measured_motion(scenario: FollowingScenario, insertion: Insertion) -> Diagram:
    """Return the planned motion with the probe's measured pose: late, and calibrated wrongly."""
    seeds, station = draw_seeds(scenario), scenario.station
    builder = DiagramBuilder()
    motion = builder.AddNamedSystem(
        "planned_motion",
        PlannedMotion(
            plan=MotionPlan(scenario, insertion),
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
