"""Parameters of the guard between controller and arm, with the limits that keep 15 N."""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from sonoservo.systems.signals.requirements import (
    Bound,
    Bounded,
    NotNegative,
    Positive,
    check_bounds,
    require,
    require_within,
    within,
)

PEAK, LONGEST = 15.0, 0.05
"""Force in N that the body may feel for no longer than this time in s."""

BODY_SPEED = 0.1
"""Highest speed in m/s at which the body comes towards the probe."""

CURVATURE = 1.25e5
"""Force of the stiffest built-in contact over the square of the indentation, in N/m^2: agar presses
with 12.5 N on a 4DC7 that is 10 mm deep."""

REACTION = 0.03
"""Time in s from the force that is too much to the arm's motion: three steps of 10 ms, for the
sample, for the next one that confirms it, and for the command."""


def _coordinates(*counts: int) -> Bound:
    """Return the bound of a point, which may be empty if one of the counts is 0."""
    empty = ", or empty" if 0 in counts else ""
    return Bound(
        f"three coordinates in m{empty}",
        lambda value: len(value) in counts and bool(np.isfinite(value).all()),
    )


@dataclass(kw_only=True)
class WristSensorLimits(Bounded):
    """Limits within which the wrist sensor's samples are plausible.

    Parameters
    ----------
    max_force, max_torque
        Largest component that the sensor can measure, in N and N m. A sample that reaches it is out
        of range or saturated.
    frozen_after
        Time after which an unchanged sample, or an unchanged torque of the arm, counts as frozen,
        in s, because every real sensor has noise. It must be longer than the sensor's period. Zero
        switches the check off, as a sensor without noise requires.
    confirmed_after
        Time for which samples must be implausible until the sensor counts as faulty, in s. Shorter
        glitches are ignored.
    max_latency
        Longest time in s by which the samples may lag behind the arm's motion. It is halved where
        the wrist sensor is the only witness of the force.
    """

    max_force: Positive = 60.0
    max_torque: Positive = 20.0
    frozen_after: Annotated[float, within(0.0, 0.2)] = 0.05
    confirmed_after: Annotated[float, within(0.0, 0.05)] = 0.025
    max_latency: Annotated[float, within(0.0, 0.1)] = 0.1


@dataclass(kw_only=True)
class GuardParameters:
    """Limits of the guard, and how it retreats and resumes.

    Parameters
    ----------
    enabled
        Whether the guard acts. Without it, every command reaches the arm.
    max_force
        Contact force at which the probe retreats, in N.
    disagreement
        Difference in N between two witnesses of the force that must be noticed. Half of it is
        attributed to their zeros and to the weight of the probe; a force below that half counts
        as none.
    surface
        (3,) point on the surface of the body at rest, in W, in m. If empty, it is that of the
        station's phantom as configured; the guard never knows the phantom's true pose. Without a
        station, an empty list leaves the workspace and the depth below that point unguarded.
    max_depth
        Largest depth of the probe's face below that point, and below the place at which contact
        began, in m. It is halved where the wrist sensor is the only witness of the force.
    max_rise
        Largest height above that point at which the body can be felt, in m.
    workspace_min, workspace_max
        (3,) corners of the box in which the probe's face may be, along the axes of W and relative
        to that point, in m.
    max_tilt_deg
        Largest angle between the probe's axis and `kinematics.axis`, in deg.
    max_speed, max_acceleration
        Highest speed of the probe's face, in m/s, and highest mean acceleration over 20 ms, in
        m/s^2.
    max_joint_acceleration
        Highest mean acceleration of a joint over 20 ms, in rad/s^2. The limits of the joints'
        positions and speeds are those of the arm.
    max_pose_error
        Largest distance between the measured and the commanded position of the probe, in m.
    pose_frozen_after
        Time after which an unchanged measured pose counts as frozen, in s. The probe is stopped if
        it was commanded to move meanwhile; at rest a frozen pose does no harm and is only noted.
        Zero switches the check off.
    retreat_speed, retreat_acceleration
        Speed and acceleration of a retreat along the probe's axis, in m/s and m/s^2.
    clearance
        Shortest distance of a retreat, in m. It continues until no force is left.
    max_retreat
        Longest distance of a retreat, in m.
    resume_after
        Time without a cause to stop after which the controller commands again, in s.
    wrist_sensor
        Limits of plausible samples.

    A ValueError refuses limits with which a body that rises at 10 cm/s would press with more than
    15 N for more than 50 ms.
    """

    enabled: bool = True
    max_force: Annotated[float, within(1.0, PEAK)] = 10.0
    disagreement: Annotated[float, within(1.0, 4.0)] = 3.0
    surface: Annotated[list[float], _coordinates(0, 3)] = field(default_factory=list)
    max_depth: Annotated[float, within(0.001, 0.03)] = 0.02
    max_rise: Annotated[float, within(0.001, 0.1)] = 0.06
    workspace_min: Annotated[list[float], _coordinates(3)] = field(
        default_factory=lambda: [-0.25, -0.25, -0.1]
    )
    workspace_max: Annotated[list[float], _coordinates(3)] = field(
        default_factory=lambda: [0.25, 0.25, 0.12]
    )
    max_tilt_deg: Annotated[float, within(1.0, 60.0)] = 30.0
    max_speed: Annotated[float, within(0.01, 0.3)] = 0.15
    max_acceleration: Annotated[float, within(0.1, 20.0)] = 10.0
    max_joint_acceleration: Annotated[float, within(1.0, 200.0)] = 40.0
    max_pose_error: Annotated[float, within(1e-3, 0.03)] = 0.01
    pose_frozen_after: NotNegative = 0.1
    retreat_speed: Annotated[float, within(BODY_SPEED, 0.5)] = 0.3
    retreat_acceleration: Annotated[float, within(1.0, 20.0)] = 10.0
    clearance: Annotated[float, within(math.sqrt(PEAK / CURVATURE), 0.1)] = 0.02
    max_retreat: float = 0.15
    resume_after: Annotated[float, within(0.1, 60.0)] = 0.25
    wrist_sensor: WristSensorLimits = field(default_factory=WristSensorLimits)

    def __post_init__(self) -> None:
        check_bounds(self)
        below = bool(np.less(self.workspace_min, self.workspace_max).all())
        require(below, "workspace_min", self.workspace_min, "below workspace_max along each axis")
        least = self.max_rise + self.clearance
        require_within("max_retreat", self.max_retreat, least, 0.3)
        time = time_above(self.max_force, self.retreat_speed, self.retreat_acceleration)
        allowed = (
            f"less, or the retreat faster than {self.retreat_speed:g} m/s at "
            f"{self.retreat_acceleration:g} m/s^2: a body that rises at {BODY_SPEED:g} m/s would "
            f"press with more than {PEAK:g} N for {1e3 * time:.0f} ms, more than "
            f"{1e3 * LONGEST:g} ms"
        )
        require(time <= LONGEST, "max_force", self.max_force, allowed)


def time_above(max_force: float, speed: float, acceleration: float) -> float:
    """Return for how long a body that rises at `BODY_SPEED` presses with more than `PEAK`, in s.

    The force is `CURVATURE` times the square of the indentation. `REACTION` after it has exceeded
    ``max_force`` in N, the probe retreats with an acceleration in m/s^2 up to a speed in m/s.
    """
    left = (math.sqrt(PEAK) - math.sqrt(min(max_force, PEAK))) / math.sqrt(CURVATURE)
    late = BODY_SPEED * REACTION  # what the probe sinks in before it moves
    reach = BODY_SPEED**2 + 2 * acceleration * (late - left)
    if reach <= 0:
        return 0.0
    if speed <= BODY_SPEED:
        return math.inf
    began = -(late - left) / BODY_SPEED
    if late < left:
        began = (BODY_SPEED - math.sqrt(reach)) / acceleration
    ended, fastest = (BODY_SPEED + math.sqrt(reach)) / acceleration, speed / acceleration
    if ended > fastest:
        deep = late - left + BODY_SPEED * fastest - acceleration * fastest**2 / 2
        ended = fastest + deep / (speed - BODY_SPEED)
    return ended - began
