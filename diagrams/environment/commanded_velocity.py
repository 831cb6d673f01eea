"""Leaf system that passes an agent's velocity to the kinematics in place of the servo's."""

from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import declare_inputs


class CommandedVelocity(LeafSystem):
    """Outputs the velocity that an agent commands, or the servo's while it commands none.

    .. pydrake_system::

        name: CommandedVelocity
        input_ports:
        - planar_velocity
        - estimate
        - X_WP
        - agent_velocity (optional)
        output_ports:
        - moving_velocity

    All velocities are (v_x, v_z, omega_y) of P, in P, in m/s and rad/s. The agent's is fixed in the
    context; see `MakeProbeController` for the other ports.
    """

    def __init__(self) -> None:
        super().__init__()
        declare_inputs(
            self, planar_velocity=3, estimate=NeedleEstimate, X_WP=RigidTransform, agent_velocity=3
        )
        self.DeclareVectorOutputPort("moving_velocity", 3, self._calc_velocity)

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        agent = self.GetInputPort("agent_velocity")
        port = agent if agent.HasValue(context) else self.GetInputPort("planar_velocity")
        output.SetFromVector(port.Eval(context))
