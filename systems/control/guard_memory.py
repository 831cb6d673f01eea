"""Memory of the guard, and its next value after an observation."""

import math
from typing import NamedTuple, cast

from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.guard_rules import (
    NO_BREACH,
    Breach,
    Cause,
    Mode,
    Region,
    Vector,
    leaving,
    moving_too_fast,
    outside,
    retreat_speed,
)
from sonoservo.systems.control.wrist_sensor_check import SensorFault, SensorMemory
from sonoservo.systems.control.wrist_sensor_check import next_memory as next_sensor_memory

_FREE, _STILL_FREE = 0.15, 0.6
"""Shares of the largest force below which the contact counts as lost, and as lost still."""

_CALM = 2.0
"""Time in s of contact without too much force after which the approach becomes faster again."""

_TOUCH = 0.5
"""Force in N from which on the probe touches the body."""

_HARD = 1.0
"""Time in s after the first touch in which too much force is that of a hard landing."""

_MAX_CAUTION = 4
"""Number of hard landings after which the approach is as slow as it gets."""

_BRAKING = 0.1
"""Time in s after a change of mode in which the probe's inertia pulls and pushes."""

_BRISK = 0.01
"""Change of the commanded speed along the axis in m/s from which on the wrist feels inertia."""

_AT_REST = 2e-4
"""Distance in m below which the probe counts as not commanded to move."""

_SCALARS = 14


class GuardMemory(NamedTuple):
    """What the guard remembers, besides the command that it sent; all numbers.

    Parameters
    ----------
    mode, cause, value
        Present `Mode`, and `Cause` of the last intervention with the value that broke the limit.
    since, fine_since
        Times in s at which the mode was entered and since which there is no cause to stop.
    interventions
        Number of interventions.
    over
        Number of successive samples with too much force, or with force where nothing can be.
    speed
        Speed of the retreat, in m/s.
    caution, touched
        Number of hard landings that have not been followed by a calm contact, and time in s since
        which there is contact; NaN without one.
    pose_changed
        Time in s at which the measured pose last changed; NaN before the first change.
    steps
        Number of steps of the pressing force that were noted, but are no fault.
    accelerated
        Time in s at which the probe was last commanded to press or yield at another speed.
    free
        Whether the contact was lost in the retreat. The probe's inertia, felt while it brakes, is
        no contact.
    p, velocity
        (3,) position and velocity of the probe's face as commanded, in W, in m and m/s.
    start
        (3,) position at which the retreat began, in m.
    p_measured, p_then
        (3,) last measured position, and the commanded one when it last changed, in m.
    sensor
        Memory of the wrist sensor's samples.
    """

    mode: int = Mode.MONITORING
    cause: int = Cause.NONE
    value: float = math.nan
    since: float = 0.0
    fine_since: float = 0.0
    interventions: int = 0
    over: int = 0
    speed: float = 0.0
    caution: int = 0
    touched: float = math.nan
    pose_changed: float = math.nan
    steps: int = 0
    accelerated: float = -math.inf
    free: int = False
    p: Vector = 3 * (math.nan,)
    velocity: Vector = 3 * (0.0,)
    start: Vector = 3 * (0.0,)
    p_measured: Vector = 3 * (math.nan,)
    p_then: Vector = 3 * (math.nan,)
    sensor: SensorMemory = SensorMemory()

    def pack(self) -> list[float]:
        """Return all numbers in one list."""
        last, trusted, *rest = self.sensor
        scalars = cast(Vector, self[:_SCALARS])
        return [
            *scalars, *self.p, *self.velocity, *self.start, *self.p_measured, *self.p_then,
            *last, *trusted, *rest,
        ]  # fmt: skip

    @property
    def quiet_force(self) -> Vector:
        """(3,) last force in N; NaN while the guard acts or suspects anything."""
        sensor = self.sensor
        quiet = not (self.mode or self.over or sensor.suspicion or sensor.fault)
        return sensor.last[3:] if quiet else 3 * (math.nan,)

    @property
    def approach_scale(self) -> float:
        """Factor on the speed of the approach; hard landings make it slower."""
        return 0.5**self.caution


def unpack(numbers: list[float]) -> GuardMemory:
    """Return the memory from the numbers that `GuardMemory.pack` returned."""
    n = _SCALARS
    vectors = [tuple(numbers[at : at + 3]) for at in range(n, n + 15, 3)]
    last, trusted = tuple(numbers[n + 15 : n + 21]), tuple(numbers[n + 21 : n + 24])
    sensor = SensorMemory._make([last, trusted, *numbers[n + 24 :]])
    return GuardMemory._make([*numbers[:n], *vectors, sensor])


class Observation(NamedTuple):
    """What the guard sees in one step.

    Parameters
    ----------
    time
        Time in s.
    p, axis
        (3,) position of the probe's face and direction of its axis, in W, as commanded.
    p_measured
        (3,) measured position.
    p_ahead, axis_ahead
        Pose to which the controller's command leads in a moment; None if the pose is inside the
        region and the controller commands.
    seconds_ahead
        That moment, in s.
    accepted
        Whether the controller's command keeps the limits of the joints.
    wrist_force
        (6,) sample of the wrist sensor: torque, then force, in N m and N.
    contact
        (3,) force of the body on the probe, in P, in N.
    stepped
        Whether the pressing force changed by more than `NOTED_STEP` since the sample before.
    """

    time: float
    p: Vector
    axis: Vector
    p_measured: Vector
    p_ahead: Vector | None
    axis_ahead: Vector | None
    seconds_ahead: float
    accepted: bool
    wrist_force: Vector
    contact: Vector
    stepped: bool = False


def next_memory(
    memory: GuardMemory,
    seen: Observation,
    limits: GuardParameters,
    allowed: Region,
    time_step: float,
    elapsed: float | None = None,
) -> GuardMemory:
    """Return the memory after one more observation.

    Parameters
    ----------
    memory
        Memory before it.
    seen
        Observation.
    limits, allowed
        Limits, and the region in which the probe may be.
    time_step
        Time until the next command, in s.
    elapsed
        Time since the last observation, in s; by default `time_step`.
    """
    elapsed = elapsed or time_step
    force, pressing = math.hypot(*seen.contact), -seen.contact[1]
    velocity = tuple((a - b) / elapsed for a, b in zip(seen.p, memory.p, strict=True))
    changes = (v - before for v, before in zip(velocity, memory.velocity, strict=True))
    change = sum(v * a for v, a in zip(changes, seen.axis, strict=True))
    accelerated = seen.time if abs(change) > _BRISK else memory.accelerated
    # A suspicion came before the motion, which is then the controller's answer to the jump.
    brisk = seen.time - accelerated < _BRAKING and not memory.sensor.suspicion
    sensor = next_sensor_memory(
        memory.sensor,
        seen.wrist_force,
        pressing,
        seen.time,
        limits.wrist_sensor,
        moving=memory.mode == Mode.RETREATING or seen.time - memory.since < _BRAKING or brisk,
    )
    in_air = seen.p[2] > allowed.contact_top and pressing > limits.wrist_sensor.max_pull
    fine = force <= limits.max_force and not in_air
    doubted = sensor.suspicion or not sensor.started
    over = memory.over if doubted else 0 if fine else memory.over + 1
    breach = NO_BREACH
    if sensor.fault:
        breach = Breach(Cause(int(Cause.FORCE + sensor.fault)), pressing)
    elif over >= 2:  # one sample may be the inertia of a sudden motion
        too_much = force > limits.max_force
        breach = Breach(Cause.FORCE, force) if too_much else Breach(Cause.SENSOR_IN_AIR, pressing)
    else:
        breach = _breach_of_motion(memory, seen, limits, allowed, elapsed)
    explained = memory.mode or brisk or sensor.suspicion or not math.isfinite(change)
    noted = seen.stepped and not explained
    lost = _STILL_FREE if memory.free else _FREE
    # What is felt after a jump may be a contact; with most other faults, nothing is felt.
    jumped = sensor.fault in (SensorFault.JUMPED, SensorFault.DEAD)
    free = (pressing if jumped else 0.0 if sensor.fault else force) < lost * limits.max_force
    after = memory._replace(
        over=over,
        p=seen.p,
        velocity=velocity,
        accelerated=accelerated,
        steps=memory.steps + noted,
        sensor=sensor,
    )
    after = _with_pose(_with_touch(after, pressing, seen.time), seen)
    if memory.mode == Mode.MONITORING:
        return after if breach is NO_BREACH else _stop(after, breach, seen, limits, time_step)
    if memory.mode == Mode.RETREATING:
        at_edge = outside(seen.p, seen.axis, allowed).cause is Cause.WORKSPACE
        at_edge = at_edge or (jumped and seen.p[2] > allowed.contact_top)
        travelled = math.inf if at_edge else math.dist(seen.p, memory.start)
        speed = retreat_speed(memory.speed, travelled, free, time_step, limits)
        if speed:
            return after._replace(speed=speed, free=free)
        return after._replace(mode=Mode.HOLDING, speed=0.0, since=seen.time, fine_since=seen.time)
    if breach is NO_BREACH:
        if seen.time - memory.fine_since < limits.resume_after:
            return after
        return after._replace(mode=Mode.MONITORING, since=seen.time)
    at_edge = outside(seen.p, seen.axis, allowed).cause is Cause.WORKSPACE
    worse = breach.cause is Cause.FORCE or (breach.cause > Cause.FORCE > memory.cause)
    if worse and not at_edge:
        stopped = _stop(after, breach, seen, limits, time_step)
        return stopped._replace(interventions=memory.interventions)
    if breach.cause != memory.cause:
        after = after._replace(cause=breach.cause, value=breach.value)
    return after._replace(fine_since=seen.time)


def _stop(
    memory: GuardMemory,
    breach: Breach,
    seen: Observation,
    limits: GuardParameters,
    time_step: float,
) -> GuardMemory:
    """Return the memory with which an intervention begins."""
    backwards = -sum(v * a for v, a in zip(memory.velocity, seen.axis, strict=True))
    retreats = breach.cause >= Cause.FORCE
    hard = breach.cause is Cause.FORCE and seen.time - memory.touched < _HARD
    speed = max(backwards, 0.0) if math.isfinite(backwards) else 0.0
    return memory._replace(
        mode=Mode.RETREATING if retreats else Mode.HOLDING,
        cause=breach.cause,
        value=breach.value,
        since=seen.time,
        fine_since=seen.time,
        interventions=memory.interventions + 1,
        caution=min(memory.caution + hard, _MAX_CAUTION),
        touched=math.nan,
        free=False,
        speed=retreat_speed(speed, 0.0, False, time_step, limits) if retreats else 0.0,
        start=seen.p,
    )


def _with_touch(memory: GuardMemory, pressing: float, time: float) -> GuardMemory:
    """Return the memory with the time of the first touch, less cautious after a calm contact."""
    if memory.mode != Mode.MONITORING or not pressing > _TOUCH:
        return memory if memory.touched != memory.touched else memory._replace(touched=math.nan)
    if memory.touched != memory.touched:
        return memory._replace(touched=time)
    if memory.caution and time - memory.touched > _CALM:
        return memory._replace(touched=time, caution=memory.caution - 1)
    return memory


def _with_pose(memory: GuardMemory, seen: Observation) -> GuardMemory:
    """Return the memory with the newest measured pose."""
    if seen.p_measured == memory.p_measured:
        return memory
    began = memory.p_measured[0] == memory.p_measured[0]
    return memory._replace(
        p_measured=seen.p_measured,
        p_then=seen.p,
        pose_changed=seen.time if began else math.nan,
    )


def _breach_of_motion(
    memory: GuardMemory,
    seen: Observation,
    limits: GuardParameters,
    allowed: Region,
    time_step: float,
) -> Breach:
    """Return the breach of the limits on pose and motion."""
    if not math.isfinite(sum(seen.p_measured)):
        return Breach(Cause.POSE_LOST)
    if not seen.accepted:
        return Breach(Cause.COMMAND)
    unchanged = seen.p_measured == memory.p_measured
    frozen = unchanged and seen.time - memory.pose_changed > limits.pose_frozen_after > 0
    if frozen and math.dist(seen.p, memory.p_then) > _AT_REST:
        return Breach(Cause.POSE_FROZEN)
    error = math.dist(seen.p_measured, seen.p)
    if error > limits.max_pose_error:
        return Breach(Cause.POSE_ERROR, error)
    if memory.mode == Mode.MONITORING and memory.p[0] == memory.p[0]:
        step = tuple(a - b for a, b in zip(seen.p, memory.p, strict=True))
        breach = moving_too_fast(step, memory.velocity, time_step, limits)
        if breach is not NO_BREACH:
            return breach
    if seen.p_ahead is None or seen.axis_ahead is None:
        return NO_BREACH
    if memory.mode == Mode.HOLDING:
        share = time_step / seen.seconds_ahead
        step = tuple(share * (a - b) for a, b in zip(seen.p_ahead, seen.p, strict=True))
        breach = moving_too_fast(step, 3 * (0.0,), time_step, limits)
        if breach is not NO_BREACH:
            return breach
    now = outside(seen.p, seen.axis, allowed)
    return leaving(now, outside(seen.p_ahead, seen.axis_ahead, allowed))
