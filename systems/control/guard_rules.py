"""Rules by which the guard stops the robot and lets it go on, as pure functions.

Positions are of the probe's face in W, in m; an axis is the direction in W in which the probe
looks. Both are tuples of numbers, because the rules run at every step of the controller.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.wrist_sensor_check import SensorFault

Vector = tuple[float, ...]

WINDOW = 0.02
"""Time in s over which accelerations are averaged, and longest time between two checks."""

NOTED_STEP = 0.5
"""Change of the pressing force between two samples in N that is noted: in 10 ms, a body that comes
at 5 cm/s or slower changes it less."""


class Mode(IntEnum):
    """States of the guard, as numbers."""

    MONITORING = 0
    RETREATING = 1
    HOLDING = 2


class Cause(IntEnum):
    """Causes of an intervention. From `FORCE` on, the probe retreats; before, it stops."""

    NONE = 0
    COMMAND = 1
    SPEED = 2
    ACCELERATION = 3
    DEPTH = 4
    WORKSPACE = 5
    TILT = 6
    POSE_LOST = 7
    POSE_ERROR = 8
    POSE_FROZEN = 9
    FORCE = 10
    SENSOR_NOT_FINITE = 10 + SensorFault.NOT_FINITE
    SENSOR_OUT_OF_RANGE = 10 + SensorFault.OUT_OF_RANGE
    SENSOR_FROZEN = 10 + SensorFault.FROZEN
    SENSOR_JUMPED = 10 + SensorFault.JUMPED
    SENSOR_PULLING = 10 + SensorFault.PULLING
    SENSOR_DEAD = 10 + SensorFault.DEAD
    SENSOR_IN_AIR = 17


_IGNORED = {
    SensorFault.NOT_FINITE: "was not a number",
    SensorFault.OUT_OF_RANGE: "was out of range",
    SensorFault.FROZEN: "was frozen",
    SensorFault.JUMPED: "jumped",
    SensorFault.PULLING: "read a pull",
    SensorFault.DEAD: "read nothing",
}


class Breach(NamedTuple):
    """A cause to stop, and the value that breaks the limit."""

    cause: Cause
    value: float = math.nan


NO_BREACH = Breach(Cause.NONE)


def reason(cause: int, value: float, limits: GuardParameters) -> str:
    """Return the reason for an intervention as a sentence without its full stop."""
    if cause == Cause.NONE:
        return ""
    sensor = limits.wrist_sensor
    texts = {
        Cause.COMMAND: "the controller's command breaks a limit of the joints' positions, speeds "
        "or accelerations, or is not a number",
        Cause.SPEED: f"the probe was commanded to move at {value:.2f} m/s, above "
        f"{limits.max_speed:g} m/s",
        Cause.ACCELERATION: f"the probe was commanded to accelerate at {value:.0f} m/s^2, above "
        f"{limits.max_acceleration:g} m/s^2",
        Cause.DEPTH: f"the probe would go deeper than {1e3 * limits.max_depth:g} mm below the "
        "configured surface; does the wrist sensor feel the body?",
        Cause.WORKSPACE: "the probe would leave the configured workspace",
        Cause.TILT: f"the probe would tilt by more than {limits.max_tilt_deg:g} deg",
        Cause.POSE_LOST: "the measured pose of the probe is not a number",
        Cause.POSE_ERROR: f"the probe is {1e3 * value:.0f} mm from where it was commanded to be, "
        f"more than {1e3 * limits.max_pose_error:g} mm",
        Cause.POSE_FROZEN: "the measured pose of the probe is frozen",
        Cause.FORCE: f"the contact force of {value:.1f} N exceeded {limits.max_force:g} N",
        Cause.SENSOR_NOT_FINITE: "the wrist sensor's samples are not numbers",
        Cause.SENSOR_OUT_OF_RANGE: "the wrist sensor is saturated or out of its range of "
        f"{sensor.max_force:g} N and {sensor.max_torque:g} N m",
        Cause.SENSOR_FROZEN: "the wrist sensor is frozen",
        Cause.SENSOR_JUMPED: f"the wrist sensor jumped by more than {sensor.max_step:g} N, "
        "faster than a contact changes",
        Cause.SENSOR_PULLING: f"the wrist sensor reads a pull of {-value:.1f} N, but contact can "
        "only push; is it biased?",
        Cause.SENSOR_DEAD: "the wrist sensor reads nothing; is it dead, or does the contact carry "
        "the probe's weight?",
        Cause.SENSOR_IN_AIR: f"the wrist sensor reads {value:.1f} N more than "
        f"{1e3 * limits.max_rise:g} mm above the configured surface; is it biased?",
    }
    return texts[Cause(cause)]


def remark(
    ignored: int, ignored_as: int, steps: int = 0, same_samples: int = 0, same_poses: int = 0
) -> str:
    """Return what was noticed without a need to intervene; empty if nothing was.

    Parameters
    ----------
    ignored, ignored_as
        Number of implausible samples that were ignored, and the fault that the last suggested.
    steps
        Number of steps of the force by more than `NOTED_STEP`.
    same_samples, same_poses
        Numbers of samples, and of measured poses, that repeated the one before to the last bit.
    """
    texts = []
    if ignored:
        texts.append(
            f"samples of the wrist sensor that were ignored: {ignored:g}, the last because it "
            + _IGNORED[SensorFault(ignored_as)]
        )
    if steps:
        texts.append(f"steps of the force by more than {NOTED_STEP:g} N between samples: {steps:g}")
    if same_samples:
        texts.append(f"samples of the wrist sensor that repeated the one before: {same_samples:g}")
    if same_poses:
        texts.append(f"measured poses that repeated the one before: {same_poses:g}")
    return "; ".join(texts)


class Region(NamedTuple):
    """Box in W and largest tilt from a direction.

    Parameters
    ----------
    low, high
        (3,) corners of the workspace in W, in m.
    floor
        Lowest height of the probe's face, in m.
    contact_top
        Highest height at which it can touch the body, in m.
    axis
        (3,) direction from which the tilt counts, in W.
    min_cosine
        Cosine of the largest tilt.
    """

    low: Vector
    high: Vector
    floor: float
    contact_top: float
    axis: Vector
    min_cosine: float


def region(limits: GuardParameters, surface: Sequence[float], axis: Sequence[float]) -> Region:
    """Return the region in which the probe may be.

    Parameters
    ----------
    limits
        Limits of the guard.
    surface
        (3,) point on the surface of the body at rest, in W, in m; if empty, only the tilt counts.
    axis
        (3,) unit vector along which the probe should look, in W.
    """
    cosine = math.cos(math.radians(limits.max_tilt_deg))
    if not len(surface):
        nowhere = 3 * (math.inf,)
        return Region(3 * (-math.inf,), nowhere, -math.inf, math.inf, tuple(axis), cosine)
    low, high = (
        tuple(s + d for s, d in zip(surface, corner, strict=True))
        for corner in (limits.workspace_min, limits.workspace_max)
    )
    floor, top = surface[2] - limits.max_depth, surface[2] + limits.max_rise
    return Region(low, high, floor, top, tuple(axis), cosine)


def outside(p: Vector, axis: Vector, allowed: Region) -> Breach:
    """Return the way in which a pose is outside a region, and by how much, in m or as a cosine."""
    x, y, z = p
    low, high = allowed.low, allowed.high
    if z < allowed.floor:
        return Breach(Cause.DEPTH, allowed.floor - z)
    if not (low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]):
        beyond = (max(a - b, b - c, 0.0) for a, b, c in zip(low, p, high, strict=True))
        return Breach(Cause.WORKSPACE, math.hypot(*beyond))
    cosine = sum(a * b for a, b in zip(axis, allowed.axis, strict=True))
    if cosine < allowed.min_cosine:
        return Breach(Cause.TILT, allowed.min_cosine - cosine)
    return NO_BREACH


def leaving(now: Breach, soon: Breach) -> Breach:
    """Return the breach of a motion that starts outside a region or ends there.

    A motion back into the region is none, so the controller can correct what it is blamed for.

    Parameters
    ----------
    now, soon
        Results of `outside` for the present pose and for the pose to which the motion leads.
    """
    if soon.cause is Cause.NONE or (now.cause is soon.cause and soon.value < now.value):
        return NO_BREACH
    return soon


def moving_too_fast(
    step: Vector, velocity: Vector, time_step: float, limits: GuardParameters
) -> Breach:
    """Return the breach of the limits on the speed and the acceleration of the probe.

    Parameters
    ----------
    step
        (3,) displacement in the last step, in m.
    velocity
        (3,) velocity before it, in m/s.
    time_step
        Duration of the step, in s.
    limits
        Limits of the guard.
    """
    speed = math.hypot(*step) / time_step
    if speed > limits.max_speed:
        return Breach(Cause.SPEED, speed)
    change = math.dist(step, [v * time_step for v in velocity]) / time_step
    acceleration = change / max(time_step, WINDOW)
    if acceleration > limits.max_acceleration:
        return Breach(Cause.ACCELERATION, acceleration)
    return NO_BREACH


def contact_force(wrist_force: Vector, down_P: Vector, weight: float) -> Vector:
    """Return the (3,) force of the body on the probe, in P, in N.

    In motion, it also contains the probe's inertial force.

    Parameters
    ----------
    wrist_force
        (3,) force of the arm on the probe, in P, in N.
    down_P
        (3,) direction of gravity in P.
    weight
        Weight of the probe, in N.
    """
    return tuple(-f - weight * d for f, d in zip(wrist_force, down_P, strict=True))


def retreat_speed(
    speed: float, travelled: float, free: bool, time_step: float, limits: GuardParameters
) -> float:
    """Return the speed of a retreat one step later, in m/s; it ends at zero.

    Parameters
    ----------
    speed
        Present speed, in m/s.
    travelled
        Distance from the start of the retreat, in m.
    free
        Whether the contact is lost, as far as the sensor can be believed.
    time_step
        Duration of the step, in s.
    limits
        Limits of the guard.
    """
    change = limits.retreat_acceleration * time_step
    braking = travelled + speed**2 / (2 * limits.retreat_acceleration)
    if braking >= (limits.clearance if free else limits.max_retreat):
        return max(speed - change, 0.0)
    return min(speed + change, limits.retreat_speed)
