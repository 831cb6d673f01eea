"""Needle trackers: diagrams that turn volumes into an estimate of the needle."""

from pydrake.systems.framework import Diagram, System

from sonoservo.diagrams.trackers.chatelain2013 import Chatelain2013TrackerParameters
from sonoservo.diagrams.trackers.registry import TRACKERS
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.calibration.pose_corrector import PoseCorrector
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.ports import DiagramBuilder


def MakeNeedleTracker(
    *,
    parameters: TrackerParameters | None = None,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
    correct_poses: bool = False,
) -> Diagram:
    """Make a needle tracker.

    .. pydrake_system::

        name: needle_tracker
        input_ports:
        - volume
        output_ports:
        - estimate
        - measurement
        - detection
        - explanation
        - lines (of trackers that follow several lines)
        - lines_explanation (of trackers that follow several lines)
        - volume_check
        - corrected_volume (if it corrects poses)
        - pose_errors (if it corrects poses)

    ``volume`` is a `Volume`, or a `NotFound` while there is none; ``estimate`` a `NeedleEstimate`.
    ``measurement`` and ``detection`` are those of the last update, for a log. ``explanation`` is
    the `LocalizationExplanation` of the volume at the input, computed on demand. ``lines`` are the
    `LineHypotheses` that are followed, and ``lines_explanation`` is their `LinesExplanation`.
    ``volume_check`` is the `VolumeCheck` of all volumes so far; refused volumes are not tracked.
    ``corrected_volume`` and ``pose_errors`` are those of a `PoseCorrector`; estimates then hold in
    W for the poses of the corrected volume.

    Parameters
    ----------
    parameters
        Parameters of one of the `TRACKERS`; their class chooses the tracker.
    period, offset
        Period and offset of the events at which it looks for a new volume, in s.
    seed
        Seed of every random choice.
    correct_poses
        Whether a `PoseCorrector` first corrects the poses of the volumes.
    """
    parameters = parameters or Chatelain2013TrackerParameters()
    diagram = TRACKERS[type(parameters)](
        parameters=parameters,
        period=period,
        offset=offset,
        seed=seed,
    )
    if correct_poses:
        diagram = _calibrated(diagram, PoseCorrector(period=period, offset=offset))
    diagram.set_name("needle_tracker")
    return diagram


def _calibrated(tracker: Diagram, corrector: PoseCorrector) -> Diagram:
    """Return a tracker behind a corrector of poses, with the output ports of both."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("pose_corrector", corrector)
    builder.AddNamedSystem("needle_tracker", tracker)
    builder.Connect(corrector.GetOutputPort("volume"), tracker.GetInputPort("volume"))
    builder.ExportInput(corrector.GetInputPort("volume"), "volume")
    for i in range(tracker.num_output_ports()):
        port = tracker.get_output_port(i)
        builder.ExportOutput(port, port.get_name())
    builder.ExportOutput(corrector.GetOutputPort("volume"), "corrected_volume")
    builder.ExportOutput(corrector.GetOutputPort("pose_errors"), "pose_errors")
    return builder.Build()


def require_tracker(tracker: object) -> System | None:
    """Return a custom tracker, or None, after checking that it is a system with a tracker's ports.

    Raises
    ------
    ConfigurationError
        If it is something else, or lacks a port.
    """
    if tracker is None:
        return None
    if not isinstance(tracker, System):
        kind = tracker.__name__ if isinstance(tracker, type) else type(tracker).__name__
        what = f"the class {kind}" if isinstance(tracker, type) else f"a value of type {kind}"
        raise ConfigurationError(f"tracker: {what}; expected an instance of a Drake system")
    name = type(tracker).__name__
    for wanted, side, exists in (
        ("volume", "input", tracker.HasInputPort("volume")),
        ("estimate", "output", tracker.HasOutputPort("estimate")),
    ):
        if not exists:
            raise ConfigurationError(
                f"tracker: {name} has no {side} port {wanted!r}; a tracker has the input 'volume' "
                "and the output 'estimate'"
            )
    return tracker
