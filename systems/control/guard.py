"""Leaf system between controller and arm that stops the robot when something is wrong."""

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

from sonoservo.systems.control.guard_memory import (
    GuardMemory,
    Observation,
    next_memory,
    unpack,
)
from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.guard_rules import (
    NO_BREACH,
    NOTED_STEP,
    WINDOW,
    Mode,
    Vector,
    contact_force,
    outside,
    reason,
    region,
    remark,
)
from sonoservo.systems.control.joint_limits import keeps_limits
from sonoservo.systems.signals.guard_status import GuardState, GuardStatus
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.scratch_context import declare_scratch_context, scratch_context

_QUIET = 0.75
"""Change of a component of the wrist force in N at which everything is checked at once."""

_NEAR = 0.5
"""Share of the largest pose error by which the position may change in a step before it is."""

_AHEAD = 0.05
"""Time in s for which the guard looks ahead at the edge of the region."""

_TOLERANCE = 1e-9
"""Rounding error of joint positions and speeds, in rad and rad/s."""

_NOTHING_SEEN = np.append(np.full(9, np.nan), [0.0, 0.0])

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
        output_ports:
        - joint_command
        - guard
        - approach_scale
        - acting

    As long as nothing is wrong, `joint_command` is `wanted_command`, bit for bit. A command that
    breaks a limit of the joints is not sent. With too much force, or a wrist sensor that cannot be
    believed, the probe retreats along its axis and then holds. With anything else, it holds at
    once. The controller commands again when there has been no cause to stop for a while (see
    `GuardParameters`).

    `wanted_command` and `joint_command` hold n positions and n velocities, in rad and rad/s.
    `wrist_force` is the SpatialForce of the arm on the probe in P, and `X_WP` the measured pose of
    the probe. `joint_state` is read only at the start. `guard` is a `GuardStatus`. A controller
    that integrates its commands must continue from `joint_command`, so it starts from where the
    guard left the arm. `approach_scale` is the factor by which it should approach more slowly: each
    landing with too much force halves it, and a calm contact doubles it again, up to one. `acting`
    is 1 while the guard, and not the controller, commands the arm, and 0 otherwise.

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
    ):
        require_positive(mass=mass, time_step=time_step)
        super().__init__()
        self._limits, self._time_step = parameters, time_step
        self._plant, self._frame = plant, probe
        self._weight = mass * UniformGravityFieldElement.kDefaultStrength
        self._region = region(parameters, surface, np.divide(axis, np.linalg.norm(axis)).tolist())
        n = self._joints = plant.num_positions()
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
        self._scratch = declare_scratch_context(self, plant)
        # The command sent at the last check, its time, the mode since then, and the quiet force.
        nothing = np.full(2 * n + 5, np.nan)
        nothing[2 * n + 1] = Mode.MONITORING
        self._command = self.DeclareDiscreteState(nothing)
        self._memory = self.DeclareDiscreteState(np.array(GuardMemory().pack()))
        self._approach_scale = self.DeclareDiscreteState([1.0])
        self._acting = self.DeclareDiscreteState(1)
        # The last step's wrist sample and measured position, and how often each was repeated.
        self._last = self.DeclareDiscreteState(_NOTHING_SEEN)
        self._sent = self.DeclareVectorOutputPort(
            "joint_command",
            2 * n,
            self._calc_joint_command,
            prerequisites_of_calc={self._wanted.ticket(), self.xd_ticket(), self.time_ticket()},
        )
        self.DeclareAbstractOutputPort(
            "guard",
            lambda: Value[object](),
            self._calc_guard,
            prerequisites_of_calc={self.xd_ticket()},
        )
        self.DeclareStateOutputPort("approach_scale", self._approach_scale)
        self.DeclareStateOutputPort("acting", self._acting)
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0, self._update)

    def _initialize(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        q = self._joint_state.Eval(context)[: self._joints]
        memory, time = GuardMemory(), context.get_time()
        command = [*q, *np.zeros_like(q), time, memory.mode, *memory.quiet_force]
        discrete_state.set_value(self._command, command)
        discrete_state.set_value(self._memory, memory.pack())
        discrete_state.set_value(self._approach_scale, [1.0])
        discrete_state.set_value(self._acting, [0.0])
        discrete_state.set_value(self._last, _NOTHING_SEEN)
        return EventStatus.Succeeded()

    def _memory_in(self, context: Context) -> GuardMemory:
        return unpack(context.get_discrete_state(self._memory).value().tolist())

    def _calc_joint_command(self, context: Context, output: BasicVector) -> None:
        last, n = context.get_discrete_state(self._command).value(), self._joints
        if last[2 * n + 1] == Mode.MONITORING:
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
        repeated = context.get_discrete_state(self._last).value()[9:]
        status = GuardStatus(
            _STATES[Mode(memory.mode)],
            reason(memory.cause, memory.value, self._limits),
            memory.since,
            int(memory.interventions),
            remark(memory.sensor.ignored, memory.sensor.ignored_as, memory.steps, *repeated),
        )
        output.set_value(status)

    def _accepts(self, wanted: NDArray[np.float64], sent: NDArray[np.float64]) -> bool:
        """Return True if a command keeps the joints' limits and continues the one sent last."""
        return bool(keeps_limits(wanted, sent, self._joint_limits))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> EventStatus:
        state = context.get_discrete_state(self._command).value().tolist()
        *last, same_sample, same_pose = context.get_discrete_state(self._last).value().tolist()
        sample = self._wrist_force.Eval(context).get_coeffs().tolist()
        p = self._X_WP.Eval(context).translation().tolist()
        if sample == last[:6] and self._limits.wrist_sensor.frozen_after:
            same_sample += 1
        if p == last[6:] and state[-4] == Mode.MONITORING and self._limits.pose_frozen_after:
            same_pose += 1
        discrete_state.set_value(self._last, [*sample, *p, same_sample, same_pose])
        elapsed = context.get_time() - state[-5]
        # Everything is checked at least every `WINDOW`; this saves half of the time.
        soon = elapsed < WINDOW - 0.5 * self._time_step
        near = _NEAR * self._limits.max_pose_error
        stepped = abs(sample[4] - last[4]) > NOTED_STEP
        calm = _close(sample[3:], state[-3:], _QUIET) and _close(p, last[6:], near)
        if soon and calm and not stepped:
            return EventStatus.Succeeded()
        before = self._memory_in(context)
        sent = self._sent.Eval(context)
        seen = self._observe(context, before, sent)._replace(stepped=stepped)
        memory = next_memory(
            before, seen, self._limits, self._region, self._time_step, max(elapsed, self._time_step)
        )
        v = sent[self._joints :].copy()
        if memory.mode != Mode.MONITORING:
            if memory.mode == Mode.RETREATING:
                v = self._retreat(context, sent[: self._joints], memory.speed)
                if not v.any():  # the arm cannot retreat further
                    memory = memory._replace(mode=Mode.HOLDING, speed=0.0)
            else:
                v *= self._slowed(memory, v)
        q, quiet = sent[: self._joints], memory.quiet_force
        command = np.concatenate([q, v, [seen.time, memory.mode, *quiet]])
        discrete_state.set_value(self._command, command)
        discrete_state.set_value(self._memory, np.array(memory.pack()))
        discrete_state.set_value(self._acting, [float(memory.mode != Mode.MONITORING)])
        if memory.caution != before.caution:
            discrete_state.set_value(self._approach_scale, [memory.approach_scale])
        return EventStatus.Succeeded()

    def _observe(
        self, context: Context, memory: GuardMemory, sent: NDArray[np.float64]
    ) -> Observation:
        """Return what the guard sees; leaves the command sent in the scratch context."""
        n, wanted = self._joints, self._wanted.Eval(context)
        p, axis, down_P = self._pose(context, sent[:n])
        wrist_force = tuple(self._wrist_force.Eval(context).get_coeffs().tolist())
        watching = memory.mode == Mode.MONITORING
        ahead: Vector | None = None
        axis_ahead: Vector | None = None
        # While the guard watches, a command that was not sent broke a limit.
        same = watching and sent.tobytes() == wanted.tobytes()
        accepted = same or (not watching and self._accepts(wanted, sent))
        if accepted and not (watching and outside(p, axis, self._region) is NO_BREACH):
            ahead, axis_ahead, _ = self._pose(context, sent[:n] + _AHEAD * wanted[n:])
        return Observation(
            context.get_time(),
            p,
            axis,
            tuple(self._X_WP.Eval(context).translation().tolist()),
            ahead,
            axis_ahead,
            _AHEAD,
            accepted,
            wrist_force,
            contact_force(wrist_force[3:], down_P, self._weight),
        )

    def _pose(self, context: Context, q: NDArray[np.float64]) -> tuple[Vector, Vector, Vector]:
        """Return the position and the axis of the probe in W, and the direction down in P."""
        plant_context = scratch_context(self._scratch, context)
        self._plant.SetPositions(plant_context, q)
        x, y, z = self._frame.CalcPoseInWorld(plant_context).GetAsMatrix34().tolist()
        return (x[3], y[3], z[3]), (x[1], y[1], z[1]), (-z[0], -z[1], -z[2])

    def _retreat(
        self, context: Context, q: NDArray[np.float64], speed: float
    ) -> NDArray[np.float64]:
        """Return joint velocities that move P backwards along its axis, or zeros."""
        plant, plant_context = self._plant, scratch_context(self._scratch, context)
        plant.SetPositions(plant_context, q)
        J = plant.CalcJacobianSpatialVelocity(
            plant_context, JacobianWrtVariable.kV, self._frame, np.zeros(3),
            plant.world_frame(), self._frame,
        )  # fmt: skip
        v = np.linalg.pinv(J, rcond=1e-2) @ np.array([0.0, 0.0, 0.0, 0.0, -speed, 0.0])
        v /= max(1.0, float((np.abs(v) / self._max_speed).max()))
        reached = np.concatenate([q + self._time_step * v, v])
        lowest, highest, _ = self._joint_limits
        possible = (reached >= lowest) & (reached <= highest)
        return np.asarray(v if possible.all() else np.zeros_like(v))

    def _slowed(self, memory: GuardMemory, v: NDArray[np.float64]) -> float:
        """Return the factor by which the joints slow down in a step."""
        speed = max(float(np.linalg.norm(memory.velocity)), 0.1 * float(np.abs(v).max()), 1e-9)
        factor = 1 - self._limits.retreat_acceleration * self._time_step / speed
        return factor if factor > 0 else 0.0


def _close(a: list[float], b: list[float], by: float) -> bool:
    """Return True if (3,) vectors differ by less than that in each component."""
    return abs(a[0] - b[0]) < by and abs(a[1] - b[1]) < by and abs(a[2] - b[2]) < by
