"""A tracker with a log of its own, which observes volumes that others see too."""

from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from sonoservo.diagrams.calibrated_tracker import MakeCalibratedTracker
from sonoservo.diagrams.experiments.following_events import observer_events, tracker_events
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.seeds import draw_seeds
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.systems.calibration.hand_eye_corrector import HandEyeCorrector
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

_LOGGED = ("true_X_WP", "X_WT", "needle", "motion_record")


def MakeLoggedTracker(
    *,
    scenario: FollowingScenario,
    tracker: str,
    drives: bool = False,
    correct_poses: bool = False,
) -> Diagram:
    """Make a tracker that observes a run, with a log of its own.

    .. pydrake_system::

        name: (the tracker's kind)
        input_ports:
        - volume
        - X_WP
        - true_X_WP
        - X_WT
        - needle
        - motion_record
        - planar_velocity (if the tracker drives)

    Only the log reads the truth; the tracker reads the volume. See `RunLogger` for the ports.

    Parameters
    ----------
    scenario
        Scenario with probe, imaging and seed.
    tracker
        Kind of the tracker, which has its default parameters.
    drives
        Whether the robot of the run follows an equal tracker.
    correct_poses
        Whether the tracker corrects the poses of its volumes first, and the log holds the pose of
        the probe with the hand-eye error taken out.
    """
    kind = next(each for each in TRACKERS if each.kind == tracker)
    make = MakeCalibratedTracker if correct_poses else MakeNeedleTracker
    needle_tracker = make(
        parameters=kind(), seed=draw_seeds(scenario).tracker, **tracker_events(scenario)
    )
    events = observer_events(scenario)
    logger = RunLogger(
        volume_period=events["period"],
        volume_offset=events["offset"],
        geometry=sweep_geometry(load_transducer(scenario.probe), scenario.imaging),
    )
    builder = DiagramBuilder()
    builder.AddNamedSystem("needle_tracker", needle_tracker)
    builder.AddNamedSystem("run_logger", logger)
    for port in ("estimate", "measurement", "detection"):
        builder.Connect(needle_tracker.GetOutputPort(port), logger.GetInputPort(port))
    builder.ExportInput(needle_tracker.GetInputPort("volume"), "volume")
    X_WP = logger.GetInputPort("X_WP")
    if correct_poses:
        corrector = builder.AddNamedSystem("hand_eye_corrector", HandEyeCorrector())
        builder.Connect(
            needle_tracker.GetOutputPort("pose_errors"), corrector.GetInputPort("pose_errors")
        )
        builder.Connect(corrector.GetOutputPort("corrected_X_WP"), X_WP)
        X_WP = corrector.GetInputPort("X_WP")
    builder.ExportInput(X_WP, "X_WP")
    for port in (*_LOGGED, *(["planar_velocity"] if drives else [])):
        builder.ExportInput(logger.GetInputPort(port), port)
    made = builder.Build()
    made.set_name(tracker)
    return made


def log_of(tracker: Diagram, context: Context) -> RunLog:
    """Return the log of a logged tracker in a run.

    Parameters
    ----------
    tracker
        Diagram from `MakeLoggedTracker`.
    context
        Its context after the run.
    """
    logger = tracker.GetSubsystemByName("run_logger")
    assert isinstance(logger, RunLogger)
    return logger.log(tracker.GetSubsystemContext(logger, context))
