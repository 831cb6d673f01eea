"""Pressing with a constant force: what the wrist says of the contact, and how fast to move.

A velocity-resolved proportional-integral law. Before contact it approaches at a constant speed;
the integral starts with contact and only near the wanted force, so that it does not wind up while
the probe lands.
"""

from dataclasses import dataclass

from pydrake.math import RotationMatrix
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import UniformGravityFieldElement

from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive


@dataclass(kw_only=True)
class ForceControllerParameters:
    """How the probe presses.

    Parameters
    ----------
    force
        To hold, in N.
    proportional_gain
        In m/s/N. Times the contact's stiffness it is the loop's bandwidth: 0.03 x 1000 N/m is 30/s.
    integral_gain
        In m/s/(N s).
    filter_time
        Of the low-pass filter on the measured force, in s.
    touch_force, release_force
        Contact begins above the one and ends below the other, in N.
    integral_band
        The integral rests while the error is larger than this, in N.
    approach_speed
        Towards the phantom, in contact or not, in m/s: it bounds the force of landing.
    retreat_speed
        Highest speed away from the phantom, in m/s.
    """

    force: float = 2.0
    proportional_gain: float = 0.02
    integral_gain: float = 0.1
    filter_time: float = 0.02
    touch_force: float = 0.4
    release_force: float = 0.2
    integral_band: float = 0.5
    approach_speed: float = 0.01
    retreat_speed: float = 0.05

    def __post_init__(self) -> None:
        require_positive(
            force=self.force,
            proportional_gain=self.proportional_gain,
            touch_force=self.touch_force,
            release_force=self.release_force,
            approach_speed=self.approach_speed,
            retreat_speed=self.retreat_speed,
        )
        require_not_negative(
            integral_gain=self.integral_gain,
            filter_time=self.filter_time,
            integral_band=self.integral_band,
        )
        order = self.release_force <= self.touch_force < self.force
        require(order, "touch_force", self.touch_force, "at least release_force and below force")


@dataclass(frozen=True)
class ForceState:
    """What the law remembers.

    Parameters
    ----------
    force
        Filtered, in N.
    integral
        Velocity that the integral asks for, in m/s.
    in_contact
        Whether the probe touches.
    """

    force: float = 0.0
    integral: float = 0.0
    in_contact: bool = False


def pressing_force(wrist_force: SpatialForce, R_WP: RotationMatrix, mass: float) -> float:
    """Force with which the probe presses along its Y axis, in N.

    The arm's force on the probe, the probe's weight and the contact's force balance; what is left
    over in motion is the probe's inertia.

    Parameters
    ----------
    wrist_force
        Of the arm on the probe, in P.
    R_WP
        Orientation of the probe.
    mass
        Of the probe, in kg.
    """
    down_P = -R_WP.matrix()[2, 1]
    weight = mass * UniformGravityFieldElement.kDefaultStrength
    return float(wrist_force.translational()[1] + weight * down_P)


def approach_velocity(state: ForceState, parameters: ForceControllerParameters) -> float:
    """Velocity along the probe's Y axis, in m/s; positive presses harder."""
    if not state.in_contact:
        return parameters.approach_speed
    error = parameters.force - state.force
    velocity = parameters.proportional_gain * error + state.integral
    return min(max(velocity, -parameters.retreat_speed), parameters.approach_speed)


def next_state(
    state: ForceState, force: float, time_step: float, parameters: ForceControllerParameters
) -> ForceState:
    """State after one more measured force, in N, `time_step` seconds later."""
    filtered = state.force + (force - state.force) * time_step / (
        parameters.filter_time + time_step
    )
    threshold = parameters.release_force if state.in_contact else parameters.touch_force
    if filtered <= threshold:
        return ForceState(force=filtered)
    error = parameters.force - filtered
    integral = state.integral
    if abs(error) < parameters.integral_band:
        integral += parameters.integral_gain * error * time_step
    return ForceState(filtered, integral, True)
