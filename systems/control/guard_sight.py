"""What the guard sees in one step, what it remembers of the steps before, and where it may be.

Positions are of the probe's face in W, in m; an axis is the direction in W in which the probe
looks. All are tuples of numbers, because the guard runs at every step of the controller.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from sonoservo.systems.control.guard_parameters import GuardParameters

Vector = tuple[float, ...]

AHEAD = 0.05
"""Time in s for which the guard looks ahead at the edge of the region."""

_NOWHERE = 3 * (math.nan,)


class Mode(IntEnum):
    """States of the guard, as numbers."""

    MONITORING = 0
    RETREATING = 1
    HOLDING = 2


class Sight(NamedTuple):
    """What the guard sees in one step.

    Parameters
    ----------
    time, step
        Time, and time since the step before, in s.
    p, axis, p_measured
        (3,) position and axis of the probe, as commanded, and its measured position.
    p_ahead, axis_ahead
        Pose to which the controller's command leads in `AHEAD`; None if the pose is inside the
        region and the controller commands.
    accepted
        Whether the controller's command keeps the limits of the joints.
    sample, plausible, force, wrist
        (6,) sample of the wrist sensor: torque, then force, in N m and N; whether its numbers are
        within the sensor's range; the force on the probe by it, and the part that presses, in N.
    arm, arm_then, arm_error
        Force with which the probe presses by the arm's torques, now and when the wrist's sample was
        taken, and its standard deviation, in N. The force is NaN if a torque is no number, and None
        if the arm reports none.
    torque
        Sum of those torques, in N m, which tells whether they change.
    latency
        Time in s by which the wrist's samples lag behind the arm's motion.
    confirmed
        Whether a person confirms that the robot may go on.
    """

    time: float
    step: float
    p: Vector
    axis: Vector
    p_measured: Vector
    p_ahead: Vector | None
    axis_ahead: Vector | None
    accepted: bool
    sample: Vector
    plausible: bool
    force: float
    wrist: float
    arm: float | None
    arm_then: float | None
    arm_error: float
    torque: float = 0.0
    latency: float = 0.0
    confirmed: bool = False


class GuardMemory(NamedTuple):
    """What the guard remembers, besides the command that it sent; all numbers.

    Parameters
    ----------
    mode, since
        Present `Mode`, and the time in s at which it was entered.
    cause, wrist_then, arm_then
        Index of the rule of the last intervention, or -1, and the forces in N by the two witnesses.
    fine_since, blocked
        Time in s since which there is no cause to stop, and whether the probe is held because a
        retreat would leave the workspace or the arm's reach.
    interventions, doubts, doubted
        Numbers of interventions, and of those with a wrong instrument since the witnesses have last
        agreed in contact; and whether the present one is among them.
    caution
        Number of hard landings that have not been followed by a calm contact.
    speed, start
        Speed of the retreat in m/s, and (3,) position in m at which it began.
    touched, depth
        Time in s since which there is contact, NaN without one, and the way along its axis in m
        that the probe has gone since then.
    wrist, rate, inertia
        Last plausible force by the wrist's sensor in N, its change in N/s, and the force in N that
        the probe's inertia explains.
    arm
        Smoothed force by the arm's torques, in N; by the wrist's sensor where the arm reports none.
    wrist_rest, arm_rest
        What `wrist` and `arm` were when the retreat ended.
    p, velocity, acceleration
        (3,) position and velocity as commanded, in W, in m and m/s, and the size of the mean
        acceleration, in m/s^2.
    sample, torque, p_measured, p_then
        What was seen last, and `p` when the measured position last changed.
    sample_changed, torque_changed, pose_changed
        Times in s at which they last changed.
    charges, noticed
        For each rule, the time in s for which its condition has held, less that for which it has
        not, and the number of steps in which it held and led to nothing.
    """

    mode: int = Mode.MONITORING
    cause: int = -1
    wrist_then: float = math.nan
    arm_then: float = math.nan
    since: float = 0.0
    fine_since: float = 0.0
    blocked: int = False
    interventions: int = 0
    doubts: int = 0
    doubted: int = False
    caution: int = 0
    speed: float = 0.0
    touched: float = math.nan
    depth: float = 0.0
    acceleration: float = 0.0
    inertia: float = 0.0
    wrist: float = math.nan
    rate: float = 0.0
    arm: float = 0.0
    wrist_rest: float = 0.0
    arm_rest: float = 0.0
    torque: float = math.nan
    sample_changed: float = math.nan
    torque_changed: float = math.nan
    pose_changed: float = math.nan
    p: Vector = _NOWHERE
    velocity: Vector = 3 * (0.0,)
    start: Vector = 3 * (0.0,)
    p_measured: Vector = _NOWHERE
    p_then: Vector = _NOWHERE
    sample: Vector = 2 * _NOWHERE
    charges: Vector = ()
    noticed: Vector = ()

    def pack(self) -> list[float]:
        """Return all numbers in one list."""
        numbers: list[float] = []
        for value in self:
            numbers.extend(value if isinstance(value, tuple) else (value,))
        return numbers

    def unpack(self, numbers: list[float]) -> "GuardMemory":
        """Return the memory of which `pack` returned the numbers; ``self`` gives the sizes."""
        values: list[float | Vector] = []
        at = 0
        for value in self:
            if isinstance(value, tuple):
                values.append(tuple(numbers[at : at + len(value)]))
                at += len(value)
            else:
                values.append(numbers[at])
                at += 1
        return GuardMemory._make(values)

    @property
    def approach_scale(self) -> float:
        """Factor on the speed of the approach; hard landings make it slower."""
        return float(0.5**self.caution)


class Region(NamedTuple):
    """Where the probe may be, in W, in m.

    Corners of the workspace, lowest height of the face and highest at which it can touch the body,
    direction from which the tilt counts and cosine of the largest, longest way along it in contact.
    """

    low: Vector
    high: Vector
    floor: float
    top: float
    axis: Vector
    min_cosine: float
    max_depth: float


def region(
    limits: GuardParameters, surface: Sequence[float], axis: Sequence[float], *, alone: bool
) -> Region:
    """Return the region about a point on the surface and a direction, if any, as in `Guard`.

    Where the wrist's sensor is ``alone`` in telling the force, only half the depth is allowed.
    """
    length = math.hypot(*axis)
    along = tuple(each / length for each in axis)
    cosine = math.cos(math.radians(limits.max_tilt_deg))
    depth = limits.max_depth / 2 if alone else limits.max_depth
    if not len(surface):
        endless = 3 * (math.inf,)
        return Region(3 * (-math.inf,), endless, -math.inf, math.inf, along, cosine, depth)
    low, high = (
        tuple(s + d for s, d in zip(surface, corner, strict=True))
        for corner in (limits.workspace_min, limits.workspace_max)
    )
    floor, top = surface[2] - depth, surface[2] + limits.max_rise
    return Region(low, high, floor, top, along, cosine, depth)


def along(p: Vector, axis: Vector) -> float:
    """Return the place of a point along an axis."""
    return p[0] * axis[0] + p[1] * axis[1] + p[2] * axis[2]
