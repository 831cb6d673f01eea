"""Leaf system that takes the hand-eye error out of a probe's pose."""

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.calibration.pose_errors import PoseErrors
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_inputs, evaluate


class HandEyeCorrector(LeafSystem):
    """Outputs the pose of the image where a robot has that of its probe.

    .. pydrake_system::

        name: HandEyeCorrector
        input_ports:
        - X_WP
        - pose_errors
        output_ports:
        - corrected_X_WP

    ``pose_errors`` is the `PoseErrors` of a `PoseCorrector`, or a `NotFound`, with which the pose
    stays as it is. Use it to see in P what was estimated from corrected volumes. The delay is not
    corrected.
    """

    def __init__(self) -> None:
        super().__init__()
        self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        declare_inputs(self, pose_errors=(PoseErrors, NotFound))
        self.DeclareAbstractOutputPort(
            "corrected_X_WP", lambda: Value(RigidTransform()), self._calc_pose
        )

    def _calc_pose(self, context: Context, output: Value) -> None:
        X_WP: RigidTransform = self.GetInputPort("X_WP").Eval(context)
        errors = evaluate(self, context, "pose_errors", (PoseErrors, NotFound))
        output.set_value(X_WP.multiply(errors.X_PI) if isinstance(errors, PoseErrors) else X_WP)
