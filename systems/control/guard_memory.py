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
from sonoservo.systems.control.wrist_sensor_check import SensorMemory
from sonoservo.systems.control.wrist_sensor_check import next_memory as next_sensor_memory

_FREE, _STILL_FREE = 0.15, 0.6
"""Shares of the largest force below which the contact counts as lost, and as lost still."""

_SCALARS = 9


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
    free
        Whether the contact was lost in the retreat. The probe's inertia, felt while it brakes, is
        no contact.
    p, velocity
        (3,) position and velocity of the probe's face as commanded, in W, in m and m/s.
    start
        (3,) position at which the retreat began, in m.
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
    free: int = False
    p: Vector = 3 * (math.nan,)
    velocity: Vector = 3 * (0.0,)
    start: Vector = 3 * (0.0,)
    sensor: SensorMemory = SensorMemory()

    def pack(self) -> list[float]:
        """Return all numbers in one list."""
        last, trusted, *rest = self.sensor
        scalars = cast(Vector, self[:_SCALARS])
        return [*scalars, *self.p, *self.velocity, *self.start, *last, *trusted, *rest]


def unpack(numbers: list[float]) -> GuardMemory:
    """Return the memory from the numbers that `GuardMemory.pack` returned."""
    n = _SCALARS
    p, velocity, start, last, trusted = (
        tuple(numbers[n : n + 3]),
        tuple(numbers[n + 3 : n + 6]),
        tuple(numbers[n + 6 : n + 9]),
        tuple(numbers[n + 9 : n + 15]),
        tuple(numbers[n + 15 : n + 18]),
    )
    sensor = SensorMemory._make([last, trusted, *numbers[n + 18 :]])
    return GuardMemory._make([*numbers[:n], p, velocity, start, sensor])


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


def next_memory(
    memory: GuardMemory,
    seen: Observation,
    limits: GuardParameters,
    allowed: Region,
    time_step: float,
) -> GuardMemory:
    """Return the memory after one more observation, `time_step` seconds after the last one."""
    force, pressing = math.hypot(*seen.contact), -seen.contact[1]
    sensor = next_sensor_memory(
        memory.sensor,
        seen.wrist_force,
        pressing,
        seen.time,
        limits.wrist_sensor,
        moving=memory.mode == Mode.RETREATING,
    )
    in_air = seen.p[2] > allowed.contact_top and pressing > limits.wrist_sensor.max_pull
    fine = force <= limits.max_force and not in_air
    doubted = sensor.suspicion or not sensor.started
    over = 0 if doubted or fine else memory.over + 1
    breach = NO_BREACH
    if sensor.fault:
        breach = Breach(Cause(int(Cause.FORCE + sensor.fault)), pressing)
    elif over >= 2:  # one sample may be the inertia of a sudden motion
        too_much = force > limits.max_force
        breach = Breach(Cause.FORCE, force) if too_much else Breach(Cause.SENSOR_IN_AIR, pressing)
    else:
        breach = _breach_of_motion(memory, seen, limits, allowed, time_step)
    step = tuple(a - b for a, b in zip(seen.p, memory.p, strict=True))
    velocity = tuple(each / time_step for each in step)
    lost = _STILL_FREE if memory.free else _FREE
    free = bool(sensor.fault) or force < lost * limits.max_force
    after = memory._replace(over=over, p=seen.p, velocity=velocity, sensor=sensor)
    if memory.mode == Mode.MONITORING:
        return after if breach is NO_BREACH else _stop(after, breach, seen, limits, time_step)
    if memory.mode == Mode.RETREATING:
        at_edge = outside(seen.p, seen.axis, allowed).cause is Cause.WORKSPACE
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
    speed = max(backwards, 0.0) if math.isfinite(backwards) else 0.0
    return memory._replace(
        mode=Mode.RETREATING if retreats else Mode.HOLDING,
        cause=breach.cause,
        value=breach.value,
        since=seen.time,
        fine_since=seen.time,
        interventions=memory.interventions + 1,
        free=False,
        speed=retreat_speed(speed, 0.0, False, time_step, limits) if retreats else 0.0,
        start=seen.p,
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
