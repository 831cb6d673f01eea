"""Leaf system that converts the probe's wanted velocity into joint positions and velocities."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsParameters,
    DoDifferentialInverseKinematics,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    EventStatus,
    LeafSystem,
)
from scipy.linalg.lapack import dgesv

from sonoservo.systems.signals.leaves import declare_memory
from sonoservo.systems.signals.requirements import (
    NotNegative,
    check_bounds,
    require,
    require_positive,
)

Floats = NDArray[np.float64]


@dataclass(kw_only=True)
class DifferentialKinematicsParameters:
    """Parameters of the conversion of the probe's velocity into joint velocities.

    Parameters
    ----------
    axis
        (3,) direction in W with which the probe's Y axis is kept aligned.
    axis_gain
        Rate at which a deviation from that direction is corrected, in 1/s.
    posture_gain
        Rate at which an arm with more than six joints returns to its home posture, in 1/s. Only
        the joint motion that leaves the probe at rest is used for this.
    """

    axis: list[float] = field(default_factory=lambda: [0.0, 0.0, -1.0])
    axis_gain: NotNegative = 1.0
    posture_gain: NotNegative = 0.5

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.axis))
        require(len(self.axis) == 3 and length > 0, "axis", self.axis, "3 numbers, not all 0")
        check_bounds(self)


# Highest speed in rad/s at which the axis is corrected, that of the visual servo's rotation.
_MAX_TILT_SPEED = math.radians(20.0)


def probe_twist(
    planar_velocity: ArrayLike, approach_velocity: float, tilt: Sequence[float]
) -> Floats:
    """Return the (6,) spatial velocity of P, in P: rotation first, in rad/s and m/s.

    `tilt` keeps the axis aligned; its component about Y is ignored.
    """
    v_x, v_z, omega_y = np.asarray(planar_velocity).tolist()
    return np.array([tilt[0], omega_y, tilt[2], v_x, approach_velocity, v_z])


class DifferentialKinematics(LeafSystem):
    """Converts the probe's wanted velocity into commands for the joint servo.

    .. pydrake_system::

        name: DifferentialKinematics
        input_ports:
        - planar_velocity
        - approach_velocity
        - joint_state
        - sent_command (optional)
        output_ports:
        - joint_command

    In every step, Drake's differential inverse kinematics finds joint velocities that move P as
    wanted. If a limit on a joint's position or velocity requires it, P moves more slowly, but never
    in another direction. The velocities are integrated from the initial joint positions
    (`joint_state`, which is read only at the start). If `sent_command` is connected, each step
    continues from that command, which was really sent to the arm. `planar_velocity` (v_x, v_z,
    omega_y) and `approach_velocity` (v_y) are velocities of P, in P, in m/s and rad/s.
    `joint_command` holds n positions and n velocities, in rad and rad/s. If a velocity is not a
    number, the joints rest.

    An arm with more than six joints can move P in the same way with many joint velocities. The
    smallest of them is taken, plus the component of the motion towards the home posture that does
    not move P: with the pseudo-inverse J^+ and the home posture q_h,
    v = J^+ V + (I - J^+ J) k (q_h - q).

    Parameters
    ----------
    parameters
        Axis to keep, and gains.
    plant
        Finalized plant of the arm alone, with limits on its joints' positions and velocities. Its
        default positions are the home posture.
    probe
        Frame P in the plant.
    time_step
        Period of the commands, in s.
    """

    def __init__(
        self,
        *,
        parameters: DifferentialKinematicsParameters,
        plant: MultibodyPlant,
        probe: Frame,
        time_step: float,
    ):
        require_positive(time_step=time_step)
        super().__init__()
        self._plant, self._probe = plant, probe
        self._axis = np.array(parameters.axis) / np.linalg.norm(parameters.axis)
        self._axis_gain = parameters.axis_gain
        self._time_step = time_step
        n = plant.num_positions()
        self._home, self._posture_gain = plant.GetDefaultPositions(), parameters.posture_gain
        self._limits = DifferentialInverseKinematicsParameters(n, n)
        self._limits.set_time_step(time_step)
        q_limits = (plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits())
        v_limits = (plant.GetVelocityLowerLimits(), plant.GetVelocityUpperLimits())
        self._limits.set_joint_position_limits(q_limits)
        self._limits.set_joint_velocity_limits(v_limits)
        if n > 6:
            self._limits.set_nominal_joint_position(self._home)
            self._limits.set_joint_centering_gain(self._posture_gain * np.eye(n))
        lower, upper = np.concatenate([q_limits, v_limits], axis=1)
        self._bounds = np.stack([lower, upper, np.full(2 * n, np.inf)])
        self._origin, self._world = np.zeros(3), plant.world_frame()
        self._planar_velocity = self.DeclareVectorInputPort("planar_velocity", 3)
        self._approach_velocity = self.DeclareVectorInputPort("approach_velocity", 1)
        self._joint_state = self.DeclareVectorInputPort("joint_state", 2 * n)
        self._sent = self.DeclareVectorInputPort("sent_command", 2 * n)
        self._scratch = declare_memory(self, plant.CreateDefaultContext)
        # Joint positions and velocities, and the time at which they hold.
        self.DeclareDiscreteState(2 * n + 1)
        read = {self.xd_ticket(), self.time_ticket()}
        self.DeclareVectorOutputPort("joint_command", 2 * n, self._calc_joint_command, read)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0, self._update_joint_command)

    def _initialize(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        q, _ = np.split(self._joint_state.Eval(context), 2)
        discrete_state.set_value(np.concatenate([q, np.zeros_like(q), [context.get_time()]]))
        return EventStatus.Succeeded()

    def _joint_command(self, context: Context) -> tuple[Floats, Floats]:
        state = context.get_discrete_state_vector().value()
        n = len(state) // 2
        q, v = state[:n], state[n : 2 * n]
        return q + (context.get_time() - state[-1]) * v, v

    def _calc_joint_command(self, context: Context, output: BasicVector) -> None:
        # A plant with a shorter step needs a ramp. A staircase would make the joints jerk, and the
        # wrist would feel the probe's inertia.
        output.SetFromVector(np.concatenate(self._joint_command(context)))

    def _update_joint_command(self, context: Context, discrete_state: DiscreteValues) -> None:
        if self._sent.HasValue(context):
            sent = self._sent.Eval(context)
            q, v = sent[: len(sent) // 2], sent[len(sent) // 2 :]
        else:
            q, v = self._joint_command(context)
        plant, frame = self._plant, self._probe
        plant_context = self._scratch(context)
        plant.SetPositions(plant_context, q)
        R_WP = frame.CalcPoseInWorld(plant_context).GetAsMatrix34()[:, :3]
        x, _, z = (R_WP.T @ self._axis).tolist()
        # The shortest rotation from Y_P to the axis.
        gain = min(self._axis_gain, _MAX_TILT_SPEED / max(math.hypot(x, z), 1e-9))
        tilt = (gain * z, 0.0, -gain * x)
        V_WP_P = probe_twist(
            self._planar_velocity.Eval(context), self._approach_velocity.Eval(context).item(), tilt
        )
        J = plant.CalcJacobianSpatialVelocity(
            plant_context, JacobianWrtVariable.kV, frame, self._origin, self._world, frame
        )
        v_next = self._joint_velocities(q, v, V_WP_P, J)
        discrete_state.set_value(0, np.concatenate([q, v_next, [context.get_time()]]))

    def _joint_velocities(
        self, q: Floats, v: Floats, V_WP_P: Floats, J: Floats
    ) -> NDArray[np.floating]:
        """Return velocities that solve J v = V, or come as close to V as the limits allow."""
        if not math.isfinite(sum(V_WP_P.tolist())):
            return np.zeros_like(q)
        # Within the limits the optimum has a closed form. Otherwise an optimization program must be
        # solved, at ten times the cost.
        direct = self._unlimited_velocities(q, V_WP_P, J)
        reached = np.concatenate([q + self._time_step * direct, direct])
        if keeps_limits(reached, reached, self._bounds):
            return direct
        result = DoDifferentialInverseKinematics(q, v, V_WP_P, J, self._limits)
        return np.zeros_like(q) if result.joint_velocities is None else result.joint_velocities

    def _unlimited_velocities(self, q: Floats, V_WP_P: Floats, J: Floats) -> NDArray[np.floating]:
        """Return velocities that solve J v = V, or NaN where there are none."""
        if len(q) == 6:
            _, _, v, singular = dgesv(J, V_WP_P)
            return np.full_like(q, np.nan) if singular else v
        homewards = self._posture_gain * (self._home - q)
        try:
            return homewards + np.linalg.pinv(J) @ (V_WP_P - J @ homewards)
        except np.linalg.LinAlgError:
            return np.full_like(q, np.nan)


@njit(cache=True)
def keeps_limits(wanted: Any, last: Any, limits: Any) -> bool:  # pragma: no cover - compiled
    """Return True if a command keeps the limits of the joints and continues the last one.

    Both hold positions and velocities, the last one NaN where nothing has to be continued. The (3,
    2n) limits are least and greatest values, and largest changes.
    """
    for i in range(len(wanted)):
        if not limits[0, i] <= wanted[i] <= limits[1, i]:
            return False
        if abs(wanted[i] - last[i]) > limits[2, i]:
            return False
    return True
