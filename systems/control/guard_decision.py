"""Decision of the guard in each step: to watch, to retreat or to hold."""

import math

from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.guard_rules import (
    CAUSES,
    MAX_DOUBTS,
    RULES,
    WINDOW,
    Reaction,
    beyond,
    judge,
)
from sonoservo.systems.control.guard_sight import GuardMemory, Mode, Region, Sight, along

_TOUCH = 1.0  # Force in N from which on the probe touches the body
_SMOOTH = 0.05  # Time in s over which the force by the arm's torques is smoothed to tell contact
# Time in s of contact without a cause to stop after which instruments are believed again.
_AGREED = 1.0
# Time in s of contact without too much force after which the approach becomes faster again.
_CALM = 2.0
_HARD = 1.0  # Time in s after the first touch in which too much force is that of a hard landing
_MAX_CAUTION = 4  # Number of hard landings after which the approach is as slow as it gets
# Share of the probe's inertial force that is left after a step of 10 ms, as the servo follows.
_SERVO = 0.5
# Factors on the time before the controller commands again, by the number of doubts: a fault of 5
# s has ended before the third landing.
_PATIENCE = (1.0, 1.0, 20.0)


EMPTY = GuardMemory(charges=len(RULES) * (0.0,), noticed=len(RULES) * (0.0,))
"""Memory at the start."""


def next_memory(
    memory: GuardMemory, seen: Sight, limits: GuardParameters, allowed: Region, mass: float
) -> GuardMemory:
    """Return the memory after one more step of a probe with a mass in kg."""
    m, cause, quiet = judge(seen, _observed(memory, seen, mass), limits, allowed)
    if cause >= 0 or not quiet:
        m = m._replace(fine_since=seen.time)
    if m.mode == Mode.MONITORING:
        if cause >= 0:
            return _stop(m, cause, seen, limits)._replace(interventions=m.interventions + 1)
        return _calmer(m, seen)
    if m.mode == Mode.RETREATING:
        return _retreating(m, seen, limits, allowed)
    if cause >= 0:
        graver = (
            RULES[cause].reaction > RULES[int(m.cause)].reaction or cause == CAUSES["force_rises"]
        )
        if graver and not beyond(seen.p, seen.axis, m, allowed)[1] > 0:
            return _stop(m, cause, seen, limits)
        return m if cause == m.cause else _blamed(m, cause, seen)
    wait = limits.resume_after * _PATIENCE[min(int(m.doubts), len(_PATIENCE) - 1)]
    if m.doubts >= MAX_DOUBTS:
        if not seen.confirmed:
            return m
        m = m._replace(doubts=0)
    if seen.time - m.fine_since < wait - 1e-9:
        return m
    return m._replace(
        mode=Mode.MONITORING, since=seen.time, blocked=False, doubted=False, touched=math.nan
    )


def _observed(m: GuardMemory, s: Sight, mass: float) -> GuardMemory:
    """Return the memory with what is seen, before anything is concluded from it."""
    velocity = tuple((a - b) / s.step for a, b in zip(s.p, m.p, strict=True))
    if velocity[0] != velocity[0]:  # the first step
        velocity = m.velocity
    changes = tuple(a - b for a, b in zip(velocity, m.velocity, strict=True))
    pushed = mass * abs(along(changes, s.axis)) / s.step
    wrist, rate = m.wrist, 0.0
    if s.plausible:
        wrist, rate = s.wrist, (s.wrist - m.wrist) / s.step if m.wrist == m.wrist else 0.0
    felt = wrist if s.arm is None else s.arm if math.isfinite(s.arm) else m.arm
    arm = m.arm + (felt - m.arm) * s.step / (_SMOOTH + s.step)
    touched = m.touched
    if not arm > _TOUCH / (1 if touched != touched else 2):
        touched = math.nan
    elif touched != touched:
        touched = s.time
    since = m.depth + along(velocity, s.axis) * s.step if touched == m.touched else 0.0
    moved = s.p_measured != m.p_measured
    return m._replace(
        touched=touched,
        depth=since,
        acceleration=math.hypot(*changes) / max(s.step, WINDOW),
        inertia=max(pushed, m.inertia * _SERVO ** (s.step / 0.01)),
        wrist=wrist,
        rate=rate,
        arm=arm,
        torque=s.torque,
        sample_changed=m.sample_changed if s.sample == m.sample else s.time,
        torque_changed=m.torque_changed if s.torque == m.torque else s.time,
        pose_changed=s.time if moved else m.pose_changed,
        p=s.p,
        velocity=velocity,
        p_measured=s.p_measured,
        p_then=s.p if moved else m.p_then,
        sample=s.sample,
    )


def _blamed(m: GuardMemory, cause: int, s: Sight) -> GuardMemory:
    """Return the memory with another cause, which is doubted if it is an instrument."""
    doubts = RULES[cause].reaction is Reaction.PROVE and not m.doubted
    arm = math.nan if s.arm is None else s.arm
    return m._replace(
        cause=cause,
        wrist_then=s.wrist,
        arm_then=arm,
        doubted=m.doubted or doubts,
        doubts=min(m.doubts + doubts, MAX_DOUBTS),
    )


def _stop(m: GuardMemory, cause: int, s: Sight, limits: GuardParameters) -> GuardMemory:
    """Return the memory with which an intervention begins."""
    backwards = max(-along(m.velocity, s.axis), 0.0)
    touches = m.touched == m.touched or (s.plausible and s.wrist - m.inertia > _TOUCH)
    away = touches or RULES[cause].reaction >= Reaction.AWAY
    hard = cause == CAUSES["force"] and s.time - m.touched < _HARD
    return _blamed(m, cause, s)._replace(
        mode=Mode.RETREATING if away else Mode.HOLDING,
        since=s.time,
        fine_since=s.time,
        blocked=False,
        caution=min(m.caution + hard, _MAX_CAUTION),
        speed=retreat_speed(backwards, 0.0, False, s.step, limits) if away else 0.0,
        start=s.p,
        wrist_rest=m.wrist,
        arm_rest=m.arm,
    )


def _retreating(m: GuardMemory, s: Sight, limits: GuardParameters, allowed: Region) -> GuardMemory:
    """Return the memory during a retreat, which ends where witnesses and place say free."""
    at_edge = beyond(s.p, s.axis, m, allowed)[1] > 0
    above = s.p[2] > allowed.top
    felt = []
    if s.plausible:
        felt.append(s.wrist - m.inertia)
    if s.arm is not None and math.isfinite(s.arm):
        felt.append(s.arm - s.arm_error)
    # Of two witnesses that contradict each other, the one that feels nothing is believed here: a
    # force that rises again is noticed while the probe is held.
    doubted = m.charges[CAUSES["disagree"]] or m.cause == CAUSES["disagree"]
    most = (min if doubted else max)(felt, default=math.inf)
    free = above or most < limits.disagreement / 2
    travelled = math.inf if at_edge or above else math.dist(s.p, m.start)
    speed = retreat_speed(m.speed, travelled, free, s.step, limits)
    if speed:
        return m._replace(speed=speed)
    return m._replace(
        mode=Mode.HOLDING,
        speed=0.0,
        blocked=at_edge and not free,
        since=s.time,
        fine_since=s.time,
        wrist_rest=m.wrist,
        arm_rest=m.arm,
    )


def _calmer(m: GuardMemory, s: Sight) -> GuardMemory:
    """Return the memory after a step of normal work, less doubtful and cautious after a while."""
    contact = s.time - m.touched
    if m.doubts and contact > _AGREED:
        m = m._replace(doubts=0)
    if m.caution and contact > _CALM:
        m = m._replace(caution=m.caution - 1, touched=s.time)
    return m


def retreat_speed(
    speed: float, travelled: float, free: bool, time_step: float, limits: GuardParameters
) -> float:
    """Return the speed in m/s of a retreat one step later, a distance in m from its start."""
    change = limits.retreat_acceleration * time_step
    braking = travelled + speed**2 / (2 * limits.retreat_acceleration)
    if braking >= (limits.clearance if free else limits.max_retreat):
        return max(speed - change, 0.0)
    return min(speed + change, limits.retreat_speed)
