"""Leaf system that computes the pose of a frame from the positions of an arm's joints."""

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.leaves import declare_memory
from sonoservo.systems.signals.ports import declare_output


class ForwardKinematics(LeafSystem):
    """Computes the pose of a frame as an arm's controller does, from measured joint positions.

    .. pydrake_system::

        name: ForwardKinematics
        input_ports:
        - joint_state
        output_ports:
        - pose

    `joint_state` holds n positions, then n velocities, in rad and rad/s; `pose` is the
    RigidTransform X_WF of the frame F. It is as accurate as the plant's model of the arm.

    Parameters
    ----------
    plant
        Finalized plant of the arm alone.
    frame
        Frame F in the plant.
    """

    def __init__(self, *, plant: MultibodyPlant, frame: Frame):
        super().__init__()
        self._plant, self._frame = plant, frame
        self._scratch = declare_memory(self, plant.CreateDefaultContext)
        state = self.DeclareVectorInputPort("joint_state", 2 * plant.num_positions())
        declare_output(self, "pose", RigidTransform, self._calc_pose, {state.ticket()})

    def _calc_pose(self, context: Context, output: Value) -> None:
        positions = self.get_input_port().Eval(context)[: self._plant.num_positions()]
        scratch = self._scratch(context)
        self._plant.SetPositions(scratch, positions)
        output.set_value(self._frame.CalcPoseInWorld(scratch))
