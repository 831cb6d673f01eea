"""Inputs of the guard in one step, its memory of the steps before, and the region it allows.

Positions are of the probe's face in W, in m; an axis is the direction in W in which the probe
looks. All are tuples of numbers, because the guard runs at every step of the controller.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from itertools import chain, islice
from typing import Any, NamedTuple

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
    """What the guard sees in one step."""

    time: float  # in s
    step: float  # time since the step before, in s
    p: Vector  # (3,) position and axis of the probe, as commanded
    axis: Vector
    p_measured: Vector  # (3,) measured position
    # Pose to which the controller's command leads in `AHEAD`; None if the pose is inside the region
    # and the controller commands.
    p_ahead: Vector | None
    axis_ahead: Vector | None
    accepted: bool  # whether the controller's command keeps the limits of the joints
    sample: Vector  # (6,) torque, then force by the wrist sensor, in N m and N
    plausible: bool  # whether these are within the sensor's range
    force: float  # force on the probe by it, in N
    wrist: float  # part of it that presses
    # Force in N with which the probe presses by the arm's torques: NaN if one is no number, None if
    # the arm reports none.
    arm: float | None
    arm_then: float | None  # the same when the wrist's sample was taken
    arm_error: float  # its standard deviation
    torque: float = 0.0  # sum of those torques in N m, which tells whether they change
    latency: float = 0.0  # time in s by which the wrist's samples lag behind the arm's motion
    confirmed: bool = False  # whether a person confirms that the robot may go on


class GuardMemory(NamedTuple):
    """What the guard remembers, besides the command that it sent; all numbers, in SI units."""

    mode: int = Mode.MONITORING
    cause: int = -1  # index of the rule of the last intervention, or -1
    wrist_then: float = math.nan  # forces by the two witnesses then
    arm_then: float = math.nan
    since: float = 0.0  # time at which the mode was entered
    fine_since: float = 0.0  # time since which there is no cause to stop
    blocked: int = False  # held because a retreat would leave the workspace or the arm's reach
    interventions: int = 0
    doubts: int = 0  # those with a wrong instrument since the witnesses last agreed in contact
    doubted: int = False  # whether the present intervention is among them
    caution: int = 0  # hard landings that have not been followed by a calm contact
    speed: float = 0.0  # of the retreat
    touched: float = math.nan  # time since which there is contact, NaN without one
    depth: float = 0.0  # way along its axis that the probe has gone since then
    acceleration: float = 0.0  # size of the mean acceleration as commanded
    inertia: float = 0.0  # force that the probe's inertia explains
    wrist: float = math.nan  # last plausible force by the wrist's sensor, and its change in N/s
    rate: float = 0.0
    arm: float = 0.0  # smoothed force by the arm's torques, or by the wrist where there are none
    wrist_rest: float = 0.0  # what these were when the retreat ended
    arm_rest: float = 0.0
    torque: float = math.nan  # seen last
    sample_changed: float = math.nan  # times at which these last changed
    torque_changed: float = math.nan
    pose_changed: float = math.nan
    p: Vector = _NOWHERE  # position and velocity as commanded
    velocity: Vector = 3 * (0.0,)
    start: Vector = 3 * (0.0,)  # position at which the retreat began
    p_measured: Vector = _NOWHERE  # seen last
    p_then: Vector = _NOWHERE  # `p` when the measured position last changed
    sample: Vector = 2 * _NOWHERE  # seen last
    charges: Vector = ()  # for each rule, the time for which it has held, less that it has not
    noticed: Vector = ()  # and the number of steps in which it held and led to nothing

    def pack(self) -> list[float]:
        """Return all numbers in one list."""
        fields: tuple[Any, ...] = self
        return [*fields[:_SINGLE], *chain.from_iterable(fields[_SINGLE:])]

    def unpack(self, numbers: list[float]) -> "GuardMemory":
        """Return the memory with the numbers that `pack` returned; ``self`` gives the sizes."""
        fields: tuple[Any, ...] = self
        left = iter(numbers[_SINGLE:])
        vectors = [tuple(islice(left, len(each))) for each in fields[_SINGLE:]]
        return GuardMemory._make(numbers[:_SINGLE] + vectors)

    @property
    def approach_scale(self) -> float:
        """Factor on the speed of the approach; hard landings make it slower."""
        return float(0.5**self.caution)


_SINGLE = GuardMemory._fields.index("p")  # number of single numbers, which precede all tuples


class Region(NamedTuple):
    """Where the probe may be, in W, in m."""

    low: Vector  # corners of the workspace
    high: Vector
    floor: float  # lowest height of the face
    top: float  # highest one at which it can touch the body
    axis: Vector  # direction from which the tilt counts
    min_cosine: float  # of the largest tilt
    max_depth: float  # longest way along the axis in contact


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
