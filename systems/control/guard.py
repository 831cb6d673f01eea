"""Leaf system between controller and arm that stops the robot when something is wrong."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable, UniformGravityFieldElement
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiscreteValues,
    EventStatus,
    LeafSystem,
)

from sonoservo.systems.control.differential_kinematics import keeps_limits
from sonoservo.systems.control.force_latency import lags, next_correlation
from sonoservo.systems.control.guard_decision import EMPTY, next_memory
from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.guard_rules import WINDOW, beyond, reason, remark
from sonoservo.systems.control.guard_sight import (
    AHEAD,
    GuardMemory,
    Mode,
    Sight,
    Vector,
    along,
    region,
)
from sonoservo.systems.signals.guard_status import GuardState, GuardStatus
from sonoservo.systems.signals.leaves import declare_memory
from sonoservo.systems.signals.ports import declare_output
from sonoservo.systems.signals.requirements import require_positive

Floats = NDArray[np.float64]

_TOLERANCE = 1e-9  # Rounding error of joint positions and speeds, in rad and rad/s
# Difference of postures in rad between which the levers of the torques differ by less than 2 %.
_SAME_POSTURE = 0.02
_SERVO_STEPS = 2  # Steps from a command to the force that it takes: the command's own and the arm's
_STATES = dict(zip(Mode, GuardState, strict=True))


class Guard(LeafSystem):
    """Passes the controller's commands to the arm, and stops the arm when something is wrong.

    .. pydrake_system::

        name: Guard
        input_ports:
        - wanted_command
        - wrist_force
        - X_WP
        - joint_state
        - external_torque (optional)
        - confirmation (optional)
        output_ports:
        - joint_command
        - guard
        - approach_scale
        - acting

    As long as nothing is wrong, `joint_command` is `wanted_command`, bit for bit. A command that
    breaks a limit of the joints is not sent. `guard_rules.RULES` lists the causes for which the
    probe is stopped. A probe that touches the body, or may touch it, then retreats along its axis
    until it is free. The controller commands again once there has been no such cause for a while.

    Two witnesses tell the force: the wrist's sensor, and the arm's `external_torque`, n numbers in
    N m. A force f at the face causes torques J^T f, so f is fitted to them with the weights of
    their errors. If that port is not connected, only half the depth is allowed. An instrument that
    was wrong must agree with the other one before the next landing, and in contact; after the third
    time, a person must change `confirmation`, one number.

    `wanted_command` and `joint_command` hold n positions and n velocities, in rad and rad/s.
    `wrist_force` is the SpatialForce of the arm on the probe in P, and `X_WP` the measured pose of
    the probe. `joint_state` is read only at the start. `guard` is a `GuardStatus`. A controller
    that integrates its commands must continue from `joint_command`. `approach_scale` is the factor
    by which it should approach more slowly: each landing with too much force halves it, and a calm
    contact doubles it again. `acting` is 1 while the guard commands the arm, and 0 otherwise.

    Parameters
    ----------
    parameters
        Limits.
    plant
        Finalized plant of the arm alone, with limits on its joints' positions and velocities.
    probe
        Frame P in the plant.
    mass
        Mass carried by the wrist sensor, in kg.
    axis
        (3,) direction in W in which the probe should look, from which its tilt counts.
    surface
        (3,) point on the surface of the body at rest, in W, in m; if empty, workspace and depth are
        not guarded.
    time_step
        Period of the checks, in s.
    torque_error
        (n,) standard deviations of the errors of the external torques, in N m.
    """

    def __init__(
        self,
        *,
        parameters: GuardParameters,
        plant: MultibodyPlant,
        probe: Frame,
        mass: float,
        axis: Sequence[float],
        surface: Sequence[float] = (),
        time_step: float,
        torque_error: Sequence[float] = (),
    ):
        require_positive(mass=mass, time_step=time_step)
        super().__init__()
        self._limits, self._time_step = parameters, time_step
        self._plant, self._frame, self._mass = plant, probe, mass
        self._weight = mass * UniformGravityFieldElement.kDefaultStrength
        self._regions = [region(parameters, surface, axis, alone=alone) for alone in (False, True)]
        n = self._joints = plant.num_positions()
        self._torque_weights = np.divide(1.0, np.square(torque_error))
        self._posture: list[float] = []
        self._levers = np.zeros(n), 0.0
        speed = plant.GetVelocityUpperLimits()
        lowest = np.concatenate([plant.GetPositionLowerLimits(), -speed]) - _TOLERANCE
        highest = np.concatenate([plant.GetPositionUpperLimits(), speed]) + _TOLERANCE
        change = np.full(n, parameters.max_joint_acceleration * WINDOW)
        reach = 1.01 * max(time_step, WINDOW) * speed + _TOLERANCE
        self._joint_limits = np.stack([lowest, highest, np.concatenate([reach, change])])
        self._max_speed = speed
        self._wanted = self.DeclareVectorInputPort("wanted_command", 2 * n)
        self._wrist_force = self.DeclareAbstractInputPort("wrist_force", Value(SpatialForce()))
        self._X_WP = self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self._joint_state = self.DeclareVectorInputPort("joint_state", 2 * n)
        self._torque = self.DeclareVectorInputPort("external_torque", n)
        self._confirmation = self.DeclareVectorInputPort("confirmation", 1)
        self._scratch = declare_memory(self, plant.CreateDefaultContext)
        # The command sent at the last check, its time, and the mode since then.
        self._command = self.DeclareDiscreteState(2 * n + 2)
        self._memory = self.DeclareDiscreteState(np.array(EMPTY.pack()))
        self._approach_scale = self.DeclareDiscreteState([1.0])
        self._acting = self.DeclareDiscreteState(1)
        # Latency, expected force and confirmation at the last check, the last forces by the arm's
        # torques, and the correlation.
        self._lags = lags(time_step)
        self._latency = self.DeclareDiscreteState(3 + 5 * self._lags)
        read = {self._wanted.ticket(), self.xd_ticket(), self.time_ticket()}
        self._sent = self.DeclareVectorOutputPort(
            "joint_command", 2 * n, self._calc_joint_command, read
        )
        declare_output(self, "guard", GuardStatus, self._calc_guard, {self.xd_ticket()})
        self.DeclareStateOutputPort("approach_scale", self._approach_scale)
        self.DeclareStateOutputPort("acting", self._acting)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0, self._update)

    def _initialize(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        q = self._joint_state.Eval(context)[: self._joints]
        command = [*q, *np.zeros_like(q), context.get_time(), Mode.MONITORING]
        discrete_state.set_value(self._command, command)
        discrete_state.set_value(self._memory, EMPTY.pack())
        discrete_state.set_value(self._approach_scale, [1.0])
        discrete_state.set_value(self._acting, [0.0])
        discrete_state.set_value(self._latency, np.zeros(3 + 5 * self._lags))
        return EventStatus.Succeeded()

    def _memory_in(self, context: Context) -> GuardMemory:
        return EMPTY.unpack(context.get_discrete_state(self._memory).value().tolist())

    def _alone(self, context: Context) -> bool:
        """Return True if nothing but the wrist's sensor tells the force."""
        return not (len(self._torque_weights) and self._torque.HasValue(context))

    def _calc_joint_command(self, context: Context, output: BasicVector) -> None:
        last, n = context.get_discrete_state(self._command).value(), self._joints
        if last.item(2 * n + 1) == Mode.MONITORING:
            wanted = self._wanted.Eval(context)
            if self._accepts(wanted, last):
                output.SetFromVector(wanted)
            else:
                output.SetFromVector(np.concatenate([last[:n], np.zeros(n)]))
        else:
            q, v, time = last[:n], last[n : 2 * n], last[2 * n]
            output.SetFromVector(np.concatenate([q + (context.get_time() - time) * v, v]))

    def _calc_guard(self, context: Context, output: Value) -> None:
        memory = self._memory_in(context)
        # Without a cause it does not matter, and to ask would make the arm estimate its torques.
        alone = memory.cause >= 0 and self._alone(context)
        status = GuardStatus(
            _STATES[Mode(memory.mode)],
            reason(memory, self._limits, self._regions[alone], alone=alone),
            memory.since,
            int(memory.interventions),
            remark(memory.noticed),
        )
        output.set_value(status)

    def _accepts(self, wanted: Floats, sent: Floats) -> bool:
        """Return True if a command keeps the joints' limits and continues the one sent last."""
        return bool(keeps_limits(wanted, sent, self._joint_limits))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        before, n = self._memory_in(context), self._joints
        alone, sent = self._alone(context), self._sent.Eval(context)
        allowed = self._regions[alone]
        seen = self._look(context, before, sent, alone=alone)
        memory = next_memory(before, seen, self._limits, allowed, self._mass)
        latency = self._measured_latency(context, before, memory, seen)
        v = sent[n:].copy()
        if memory.mode != Mode.MONITORING:
            if memory.mode == Mode.RETREATING:
                v = self._retreat(context, sent[:n], memory.speed)
                if not v.any():  # the arm cannot retreat further
                    memory = memory._replace(mode=Mode.HOLDING, speed=0.0, blocked=True)
            else:
                v *= self._slowed(memory, v)
        discrete_state.set_value(
            self._command, np.concatenate([sent[:n], v, [seen.time, memory.mode]])
        )
        discrete_state.set_value(self._memory, memory.pack())
        discrete_state.set_value(self._latency, latency)
        if memory.mode != before.mode:
            discrete_state.set_value(self._acting, [float(memory.mode != Mode.MONITORING)])
        if memory.caution != before.caution:
            discrete_state.set_value(self._approach_scale, [memory.approach_scale])
        return EventStatus.Succeeded()

    def _look(self, context: Context, memory: GuardMemory, sent: Floats, *, alone: bool) -> Sight:
        """Return what the guard sees."""
        n, wanted = self._joints, self._wanted.Eval(context)
        allowed, limits = self._regions[alone], self._limits.wrist_sensor
        p, axis, down_P = self._pose(context, sent[:n])
        sample = tuple(self._wrist_force.Eval(context).get_coeffs().tolist())
        bounds = 3 * (limits.max_torque,) + 3 * (limits.max_force,)
        contact = [-f - self._weight * d for f, d in zip(sample[3:], down_P, strict=True)]
        watching = memory.mode == Mode.MONITORING
        # While the guard watches, a command that was not sent broke a limit.
        same = watching and sent.tobytes() == wanted.tobytes()
        accepted = same or (not watching and self._accepts(wanted, sent))
        ahead = axis_ahead = None
        if accepted and not (watching and max(beyond(p, axis, memory, allowed)) <= 0):
            ahead, axis_ahead, _ = self._pose(context, sent[:n] + AHEAD * wanted[n:])
        arm, error, total = None, math.nan, 0.0
        if not alone:
            torque = self._torque.Eval(context)
            levers, error = self._levers_at(context, sent[:n])
            arm, total = float(levers @ torque), float(torque.sum())
        state = context.get_discrete_state(self._latency).value()
        latency, confirmation = float(state[0]), state[2]
        late = round(latency / self._time_step)
        arm_then = arm if late == 0 or arm is None else float(state[2 + late])
        given = self._confirmation.HasValue(context)
        confirmed = given and self._confirmation.Eval(context)[0] != confirmation
        return Sight(
            context.get_time(), self._time_step, p, axis,
            p_measured=tuple(self._X_WP.Eval(context).translation().tolist()),
            p_ahead=ahead, axis_ahead=axis_ahead, accepted=accepted, sample=sample,
            plausible=all(-b < each < b for each, b in zip(sample, bounds, strict=True)),
            force=math.hypot(*contact), wrist=-contact[1], arm=arm, arm_then=arm_then,
            arm_error=error, torque=total, latency=latency, confirmed=confirmed,
        )  # fmt: skip

    def _levers_at(self, context: Context, q: Floats) -> tuple[Floats, float]:
        """Return what turns torques into the pressing force, in 1/m, and that force's error in N.

        They are those of a posture near ``q``, and kept as long as that one is the nearest.
        """
        posture = (q / _SAME_POSTURE).round().tolist()
        if posture != self._posture:
            J = self._jacobian(context, _SAME_POSTURE * np.array(posture))[3:]
            weighted = J * self._torque_weights
            covariance = np.linalg.pinv(weighted @ J.T)
            self._levers = -(covariance @ weighted)[1], math.sqrt(covariance[1, 1])
            self._posture = posture
        return self._levers

    def _jacobian(self, context: Context, q: Floats) -> Floats:
        plant, frame, scratch = self._plant, self._frame, self._scratch(context)
        plant.SetPositions(scratch, q)
        J = plant.CalcJacobianSpatialVelocity(
            scratch, JacobianWrtVariable.kV, frame, np.zeros(3), plant.world_frame(), frame
        )
        return np.asarray(J)

    def _measured_latency(
        self, context: Context, before: GuardMemory, after: GuardMemory, seen: Sight
    ) -> Floats:
        """Return the state of the measurement of the latency after a step."""
        state = context.get_discrete_state(self._latency).value()
        latency, expected_before, confirmation = state[:3].tolist()
        rest = state[3:].reshape(5, -1)
        if self._confirmation.HasValue(context):
            confirmation = self._confirmation.Eval(context)[0]
        changes = [a - b for a, b in zip(after.velocity, before.velocity, strict=True)]
        expected = self._mass * along(tuple(changes), seen.axis) / seen.step
        correlation, found = next_correlation(
            rest[1:], expected - expected_before, after.rate * seen.step, seen.step
        )
        if found == found:
            latency = max(found - _SERVO_STEPS * seen.step, 0.0)
        if not seen.plausible or seen.latency > self._limits.wrist_sensor.max_latency:
            latency, correlation = 0.0, np.zeros_like(correlation)  # to be measured anew
        start = [latency, expected, confirmation, seen.arm or 0.0]
        return np.concatenate([start, rest[0, :-1], correlation.ravel()])

    def _pose(self, context: Context, q: Floats) -> tuple[Vector, Vector, Vector]:
        """Return the position and the axis of the probe in W, and the direction down in P."""
        plant_context = self._scratch(context)
        self._plant.SetPositions(plant_context, q)
        x, y, z = self._frame.CalcPoseInWorld(plant_context).GetAsMatrix34().tolist()
        return (x[3], y[3], z[3]), (x[1], y[1], z[1]), (-z[0], -z[1], -z[2])

    def _retreat(self, context: Context, q: Floats, speed: float) -> Floats:
        """Return joint velocities that move P backwards along its axis, or zeros."""
        backwards = np.array([0.0, 0.0, 0.0, 0.0, -speed, 0.0])
        v = np.linalg.pinv(self._jacobian(context, q), rcond=1e-2) @ backwards
        v /= max(1.0, float((np.abs(v) / self._max_speed).max()))
        reached = np.concatenate([q + self._time_step * v, v])
        lowest, highest, _ = self._joint_limits
        possible = (reached >= lowest) & (reached <= highest)
        return np.asarray(v if possible.all() else np.zeros_like(v))

    def _slowed(self, memory: GuardMemory, v: Floats) -> float:
        """Return the factor by which the joints slow down in a step."""
        speed = max(float(np.linalg.norm(memory.velocity)), 0.1 * float(np.abs(v).max()), 1e-9)
        factor = 1 - self._limits.retreat_acceleration * self._time_step / speed
        return factor if factor > 0 else 0.0
