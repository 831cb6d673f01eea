"""Leaf system that outputs the pose of one body."""

from pydrake.common.value import Value
from pydrake.geometry import FrameId, FramePoseVector
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.ports import declare_output


class BodyPose(LeafSystem):
    """Selects the pose of one body of a plant.

    .. pydrake_system::

        name: BodyPose
        input_ports:
        - geometry_pose
        output_ports:
        - pose

    `geometry_pose` is the plant's FramePoseVector of the bodies with a shape; `pose` is the
    RigidTransform X_WB. The plant's list of all `body_poses` would be converted at each reading.

    Parameters
    ----------
    frame
        Geometry frame of the body (`MultibodyPlant.GetBodyFrameIdOrThrow`).
    """

    def __init__(self, *, frame: FrameId):
        super().__init__()
        self._frame = frame
        self._poses = self.DeclareAbstractInputPort("geometry_pose", Value(FramePoseVector()))
        declare_output(self, "pose", RigidTransform, self._calc_pose, {self._poses.ticket()})

    def _calc_pose(self, context: Context, output: Value) -> None:
        output.set_value(self._poses.Eval(context).value(self._frame))
