"""Leaf system that estimates the torques with which the world loads an arm's joints."""

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointIndex, MultibodyForces
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from sonoservo.systems.signals.leaves import declare_memory
from sonoservo.systems.signals.ports import declare_output
from sonoservo.systems.signals.requirements import require_not_negative, require_positive


class ExternalTorque(LeafSystem):
    """Estimates the external torques on an arm's joints, as the drives of many arms report them.

    .. pydrake_system::

        name: ExternalTorque
        input_ports:
        - joint_state
        - motor_torque
        output_ports:
        - external_torque

    What the joints need for the motion of the last period, by inverse dynamics, and what the motors
    delivered in it, differ by what the world does to the arm (De Luca and Mattone 2005):
    tau_ext = M(q) dv/dt + C(q, v) v - tau_g(q) + D v - tau_motor. `joint_state` holds n positions,
    then n velocities, in rad and rad/s; the torques are (n,), in N m. The contact is not an input.

    Parameters
    ----------
    plant
        Finalized plant of the arm with its probe alone, as its maker knows it.
    error
        (n,) standard deviations of the errors of the torques, in N m.
    period
        Period of the plant that delivers the torques, in s.
    seed
        Seed of the errors. Equal seeds and times give equal errors.
    """

    def __init__(
        self, *, plant: MultibodyPlant, error: NDArray[np.float64], period: float, seed: int
    ):
        require_not_negative(seed=seed)
        require_positive(period=period)
        super().__init__()
        self._plant, self._error, self._period = plant, np.asarray(error, dtype=float), period
        self._random = np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, 1])))
        self._random_state = self._random.bit_generator.state
        n = self._joints = plant.num_velocities()
        joints = [plant.get_joint(JointIndex(i)) for i in range(plant.num_joints())]
        self._damping = np.concatenate([joint.default_damping_vector() for joint in joints])
        self._forces = MultibodyForces(plant)
        self._scratch = declare_memory(self, plant.CreateDefaultContext)
        self._state = self.DeclareVectorInputPort("joint_state", 2 * n)
        self._motors = self.DeclareVectorInputPort("motor_torque", n)
        self._before = self.DeclareDiscreteState(np.full(n, np.nan))  # velocities
        tickets = self.all_input_ports_ticket(), self.xd_ticket(), self.time_ticket()
        declare_output(self, "external_torque", n, self._calc_external_torque, tickets)
        # The plant steps in such an event too, and both see the state before it: the velocities
        # kept here are those of the step before, whatever evaluates the output.
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0, self._update)

    def _calc_external_torque(self, context: Context, output: BasicVector) -> None:
        state, n = self._state.Eval(context), self._joints
        before = context.get_discrete_state(self._before).value()
        if np.isnan(before[0]):  # nothing has moved yet
            output.SetFromVector(np.zeros(n))
            return
        plant, scratch = self._plant, self._scratch(context)
        plant.SetPositionsAndVelocities(scratch, state)
        plant.CalcForceElementsContribution(scratch, self._forces)
        v = state[n:]
        needed = plant.CalcInverseDynamics(scratch, (v - before) / self._period, self._forces)
        noise = self._noise(context.get_time())
        output.SetFromVector(needed + self._damping * v - self._motors.Eval(context) + noise)

    def _noise(self, time: float) -> NDArray[np.float64]:
        # The noise depends on the period's number, so the estimate is repeatable without a state.
        self._random_state["state"]["counter"][1] = round(time / self._period)
        self._random.bit_generator.state = self._random_state
        return self._error * self._random.standard_normal(self._joints)

    def _update(self, context: Context, state: State) -> EventStatus:
        v = self._state.Eval(context)[self._joints :]
        state.get_mutable_discrete_state().set_value(self._before, v)
        return EventStatus.Succeeded()
