"""Needle tracker that first corrects the poses of its volumes."""

from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.systems.calibration.pose_corrector import PoseCorrector
from sonoservo.systems.signals.volume import Volume


def MakeCalibratedTracker(
    *,
    parameters: TrackerParameters | None = None,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
) -> Diagram:
    """Make a needle tracker behind a `PoseCorrector`.

    .. pydrake_system::

        name: calibrated_tracker
        input_ports:
        - volume
        output_ports:
        - estimate
        - measurement
        - detection
        - explanation
        - volume_check
        - corrected_volume
        - pose_errors

    The first ports are those of `MakeNeedleTracker`, of which a tracker may lack some. The others
    are the corrector's. Estimates hold in W for the poses of the ``corrected_volume``.

    Parameters
    ----------
    parameters, period, offset, seed
        As for `MakeNeedleTracker`.
    """
    builder = DiagramBuilder()
    corrector = builder.AddNamedSystem(
        "pose_corrector", PoseCorrector(period=period, offset=offset)
    )
    tracker = builder.AddNamedSystem(
        "needle_tracker",
        MakeNeedleTracker(parameters=parameters, period=period, offset=offset, seed=seed),
    )
    builder.Connect(corrector.GetOutputPort("volume"), tracker.GetInputPort("volume"))
    builder.ExportInput(corrector.GetInputPort("volume"), "volume")
    for i in range(tracker.num_output_ports()):
        port = tracker.get_output_port(i)
        builder.ExportOutput(port, port.get_name())
    builder.ExportOutput(corrector.GetOutputPort("volume"), "corrected_volume")
    builder.ExportOutput(corrector.GetOutputPort("pose_errors"), "pose_errors")
    diagram = builder.Build()
    diagram.set_name("calibrated_tracker")
    return diagram


def corrected_frame(
    tracker: Diagram, context: Context, volume: Volume, X_WL: RigidTransform
) -> RigidTransform:
    """Return the pose of a frame L of a volume after the volume's poses have been corrected.

    Parameters
    ----------
    tracker, context
        Calibrated tracker after the volume, and its context.
    volume, X_WL
        Volume as it was given to the tracker, and the pose of L with it.
    """
    corrected: Volume = tracker.GetOutputPort("corrected_volume").Eval(context)
    return corrected.X_WP.multiply(volume.X_WP.inverse()).multiply(X_WL)
