"""Leaf system that outputs the pose of one body."""

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.ports import declare_output


class BodyPose(LeafSystem):
    """Selects the pose of one body of a plant.

    .. pydrake_system::

        name: BodyPose
        input_ports:
        - body_poses
        output_ports:
        - pose

    `body_poses` is the plant's list of poses; `pose` is the RigidTransform X_WB.

    Parameters
    ----------
    body
        Index of the body.
    """

    def __init__(self, *, body: BodyIndex):
        super().__init__()
        self._body = int(body)
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]())
        declare_output(self, "pose", RigidTransform, self._calc_pose, {self._poses.ticket()})

    def _calc_pose(self, context: Context, output: Value) -> None:
        output.set_value(self._poses.Eval(context)[self._body])
