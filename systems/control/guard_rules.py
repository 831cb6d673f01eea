"""The guard's table of causes, conditions, times and reactions, and its one debounce."""

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import NamedTuple

from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.guard_sight import (
    AHEAD,
    GuardMemory,
    Mode,
    Region,
    Sight,
    Vector,
    along,
)

WINDOW = 0.02  # time in s over which accelerations are averaged
MAX_DOUBTS = 3  # times that an instrument is found wrong after which a person must confirm

# Time in s for which the force must be too much: a push by the probe's inertia is shorter.
_PULSE = 0.015
# Change of the pressing force between two samples in N that is noted: in 10 ms, a body that comes
# at 5 cm/s or slower changes it less.
_NOTED_STEP = 0.5
_AT_REST = 2e-4  # Distance in m below which the probe counts as not commanded to move
# Log-likelihood ratio at which witnesses disagree: by chance once in e^40 steps, or in e^27 if
# their zeros differ by a sixth of the disagreement to be found.
_NATS = 40.0
# Rate at which a condition is forgotten, as a share of that at which it is believed. A sensor
# that is wrong in every other sample is found.
_FORGET = 1 / 3
_ZERO_ERROR = 0.5  # Error in N of the wrist's force where there is no arm to compare it with


class Reaction(IntEnum):
    """What the guard does about a condition that has held for its time."""

    NOTE = 0  # counts it
    STOP = 1  # stops, and retreats if the probe touches the body
    AWAY = 2  # retreats until no force is left
    PROVE = 3  # the same, and the witnesses must agree before the next landing and during it


def _disagree(s: Sight, m: GuardMemory, g: GuardParameters, r: Region) -> float:
    # Evidence that two witnesses differ by the least that matters, as a share of what convicts: a
    # cumulative sum (Page 1954) of the logarithm of the likelihood ratio of that difference and
    # none.
    if m.mode == Mode.RETREATING or not s.plausible:
        return -_FORGET
    arm, error = s.arm_then, s.arm_error
    if arm is None:  # what a body can do to the probe where it is
        free = m.mode == Mode.HOLDING or s.p[2] > r.top
        arm, error = 0.0 if free else max(s.wrist, 0.0), _ZERO_ERROR
    elif not math.isfinite(arm):
        return -_FORGET
    difference = abs(s.wrist - arm) - m.inertia  # the inertia is felt by the wrist alone
    nats = g.disagreement * (difference - g.disagreement / 2) / error**2
    share = nats / _NATS * g.wrist_sensor.confirmed_after / s.step
    return min(max(share, -_FORGET), 1.0)


def _pose_frozen(s: Sight, m: GuardMemory, g: GuardParameters, r: Region) -> bool:
    frozen = s.time - m.pose_changed > g.pose_frozen_after > 0
    return frozen and math.dist(s.p, m.p_then) > _AT_REST


def _wanted_speed(s: Sight, m: GuardMemory) -> float:
    if m.mode == Mode.MONITORING:
        return math.hypot(*m.velocity)
    return math.dist(s.p, s.p_ahead) / AHEAD if s.p_ahead else 0.0


def _acceleration(s: Sight, m: GuardMemory, g: GuardParameters, r: Region) -> bool:
    if m.mode == Mode.HOLDING:
        return _wanted_speed(s, m) / max(s.step, WINDOW) > g.max_acceleration
    return m.mode == Mode.MONITORING and m.acceleration > g.max_acceleration


def _force(s: Sight, m: GuardMemory, g: GuardParameters, r: Region) -> bool:
    if m.mode == Mode.HOLDING:
        return False
    coming = max(m.rate, 0.0) * s.latency
    return (s.plausible and s.force + coming > g.max_force) or _arm_at_least(s) > g.max_force


def _force_rises(s: Sight, m: GuardMemory, g: GuardParameters, r: Region) -> bool:
    # What was felt when the retreat ended may be an error; the body adds to it.
    if m.mode != Mode.HOLDING:
        return False
    wrist = s.wrist - max(m.rate * s.step, 0.0) - m.inertia  # of two samples the lesser one
    felt = s.plausible and wrist - max(m.wrist_rest, 0.0) > g.max_force / 2
    return felt or _arm_at_least(s) - max(m.arm_rest, 0.0) > g.max_force / 2


def _arm_at_least(s: Sight) -> float:
    return -math.inf if s.arm is None else s.arm - 2 * s.arm_error


def _max_latency(g: GuardParameters, *, alone: bool) -> float:
    return g.wrist_sensor.max_latency / (2 if alone else 1)


def _leaves(s: Sight, m: GuardMemory, r: Region, way: int) -> bool:
    # The way back is free, so the controller can correct what it is blamed for.
    if s.p_ahead is None or s.axis_ahead is None:
        return False
    soon = beyond(s.p_ahead, s.axis_ahead, m, r)[way]
    return soon > 0 and soon >= beyond(s.p, s.axis, m, r)[way]


def beyond(p: Vector, axis: Vector, m: GuardMemory, r: Region) -> tuple[float, float, float]:
    """Return by how much a pose is too deep and outside the workspace, in m, and tilted too far."""
    further = m.depth + along(p, axis) - along(m.p, axis)
    touching = m.touched == m.touched
    deep = max(r.floor - p[2], further - r.max_depth if touching else -math.inf)
    beside = max(max(a - b, b - c) for a, b, c in zip(r.low, p, r.high, strict=True))
    return deep, beside, r.min_cosine - along(axis, r.axis)


class Rule(NamedTuple):
    """A cause: when it holds, for how many s it must, what the guard then does, and what it says.

    The condition is a function of what is seen, of what is remembered with it, of the parameters
    and of the region. It returns True or False; a likelihood returns a number from -1/3 to 1
    instead. Without a time of its own, it must hold for `wrist_sensor.confirmed_after`.
    """

    name: str
    holds: Callable[[Sight, GuardMemory, GuardParameters, Region], float]
    time: float | None
    reaction: Reaction
    text: str


# fmt: off
RULES = (
    Rule("force_rises", _force_rises, _PULSE, Reaction.AWAY,
         "the force on the probe rose by more than {half:g} N while it was held"),
    Rule("wrist_not_finite", lambda s, m, g, r: not math.isfinite(sum(s.sample)),
         None, Reaction.PROVE, "the wrist sensor's samples are not numbers"),
    Rule("wrist_out_of_range",
         lambda s, m, g, r: not s.plausible and math.isfinite(sum(s.sample)),
         None, Reaction.PROVE, "the wrist sensor is saturated or out of its range of "
         "{g.wrist_sensor.max_force:g} N and {g.wrist_sensor.max_torque:g} N m"),
    Rule("wrist_frozen",
         lambda s, m, g, r: s.time - m.sample_changed > g.wrist_sensor.frozen_after > 0,
         0.0, Reaction.PROVE, "the wrist sensor is frozen"),
    Rule("arm_not_finite", lambda s, m, g, r: s.arm is not None and not math.isfinite(s.arm),
         None, Reaction.PROVE, "the external torques of the arm are not numbers"),
    Rule("arm_frozen", lambda s, m, g, r: (
             s.arm is not None and s.time - m.torque_changed > g.wrist_sensor.frozen_after > 0),
         0.0, Reaction.PROVE, "the external torques of the arm are frozen"),
    Rule("disagree", _disagree, None, Reaction.PROVE,
         "the wrist sensor reads {wrist:.1f} N, but {other}"),
    Rule("late", lambda s, m, g, r: s.latency > _max_latency(g, alone=s.arm is None), 0.0,
         Reaction.PROVE,
         "the wrist sensor's samples lag behind the arm's motion by more than {latency:g} s"),
    Rule("force", _force, _PULSE, Reaction.AWAY,
         "the contact force exceeds {g.max_force:g} N, or would before it is measured; the "
         "witnesses felt at most {most:.1f} N along the probe"),
    Rule("depth", lambda s, m, g, r: _leaves(s, m, r, 0), 0.0, Reaction.AWAY,
         "the probe would go deeper than {depth:g} mm below the configured surface, or below "
         "the place where contact began; does the wrist sensor feel the body?"),
    Rule("pose_not_finite", lambda s, m, g, r: not math.isfinite(sum(s.p_measured)),
         0.0, Reaction.STOP, "the measured pose of the probe is not a number"),
    Rule("pose_error", lambda s, m, g, r: math.dist(s.p_measured, s.p) > g.max_pose_error,
         0.0, Reaction.STOP,
         "the probe is more than {error:g} mm from where it was commanded to be"),
    Rule("pose_frozen", _pose_frozen, 0.0, Reaction.STOP,
         "the measured pose of the probe is frozen"),
    Rule("command", lambda s, m, g, r: not s.accepted, 0.0, Reaction.STOP,
         "the controller's command breaks a limit of the joints' positions, speeds or "
         "accelerations, or is not a number"),
    Rule("speed", lambda s, m, g, r: _wanted_speed(s, m) > g.max_speed, 0.0, Reaction.STOP,
         "the probe was commanded to move faster than {g.max_speed:g} m/s"),
    Rule("acceleration", _acceleration, 0.0, Reaction.STOP,
         "the probe was commanded to accelerate at more than {g.max_acceleration:g} m/s^2"),
    Rule("workspace", lambda s, m, g, r: _leaves(s, m, r, 1), 0.0, Reaction.STOP,
         "the probe would leave the configured workspace"),
    Rule("tilt", lambda s, m, g, r: _leaves(s, m, r, 2), 0.0, Reaction.STOP,
         "the probe would tilt by more than {g.max_tilt_deg:g} deg"),
    Rule("sample_repeats",
         lambda s, m, g, r: m.sample_changed < s.time and g.wrist_sensor.frozen_after > 0,
         math.inf, Reaction.NOTE, "samples of the wrist sensor that repeated the one before"),
    Rule("pose_repeats", lambda s, m, g, r: m.pose_changed < s.time and g.pose_frozen_after > 0,
         math.inf, Reaction.NOTE, "measured poses that repeated the one before"),
    Rule("force_steps",
         lambda s, m, g, r: s.plausible and abs(m.rate) * s.step - m.inertia > _NOTED_STEP,
         math.inf, Reaction.NOTE,
         f"steps of the force by more than {_NOTED_STEP:g} N between samples"),
)
"""All causes, the gravest first."""
# fmt: on

CAUSES = {rule.name: number for number, rule in enumerate(RULES)}
"""Numbers of the causes by name."""


def judge(s: Sight, m: GuardMemory, g: GuardParameters, r: Region) -> tuple[GuardMemory, int, bool]:
    """Return the memory with new charges, the gravest confirmed cause or -1, and if all is quiet.

    A condition charges its rule with the time for which it holds, and discharges it at `_FORGET` of
    that rate when it does not. At the rule's time it is confirmed; up to half of it is quiet.
    """
    shares = [float(rule.holds(s, m, g, r)) for rule in RULES]
    if not any(share > 0 for share in shares) and not any(m.charges):
        return m, -1, True
    found, quiet, charges, noticed = -1, True, [], list(m.noticed)
    for number, (rule, share) in enumerate(zip(RULES, shares, strict=True)):
        time = g.wrist_sensor.confirmed_after if rule.time is None else rule.time
        gain = share if share > 0 else -_FORGET
        charge = min(max(m.charges[number] + gain * s.step, 0.0), max(time, s.step))
        confirmed = share > 0 and charge >= time - 1e-9
        if rule.reaction is Reaction.NOTE:
            charge = 0.0
            noticed[number] += share > 0 and m.mode == Mode.MONITORING
        elif confirmed and found < 0:
            found = number
        elif share >= 1 and not confirmed and rule.name != "disagree":
            noticed[number] += 1
        quiet = quiet and not charge > time / 2
        charges.append(charge)
    return m._replace(charges=tuple(charges), noticed=tuple(noticed)), found, quiet


def reason(m: GuardMemory, g: GuardParameters, r: Region, *, alone: bool) -> str:
    """Return the reason for the last intervention as a sentence without its full stop."""
    if m.cause < 0:
        return ""
    arm = f"the arm's torques say {m.arm_then:.1f} N"
    other = "nothing can press or pull there" if alone else arm
    most = max((each for each in (m.wrist_then, m.arm_then) if each == each), default=math.nan)
    text = RULES[int(m.cause)].text.format(
        g=g, wrist=m.wrist_then, other=other, most=most, error=1e3 * g.max_pose_error,
        depth=1e3 * r.max_depth, half=g.max_force / 2, latency=_max_latency(g, alone=alone),
    )  # fmt: skip
    if m.blocked:
        text += "; it is held, because a retreat would leave the workspace or the arm's reach"
    if m.mode and m.doubts >= MAX_DOUBTS:
        text += f"; {MAX_DOUBTS} such stops, so a person must confirm"
    return text


def remark(noticed: Sequence[float]) -> str:
    """Return what was noticed without a need to intervene, with its number of steps."""
    texts = []
    for rule, count in zip(RULES, noticed, strict=True):
        if count:
            short = f"too short for a stop ({rule.name.replace('_', ' ')})"
            text = rule.text if rule.reaction is Reaction.NOTE else short
            texts.append(f"{text}: {count:g}")
    return "; ".join(texts)
