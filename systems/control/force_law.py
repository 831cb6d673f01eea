"""Force law: the pressing force from the wrist's sensor, and the velocity that keeps it constant.

The law is a proportional-integral one with a velocity as its output. Before contact the probe
approaches at a constant speed. The integral grows only in contact and near the wanted force, to
avoid wind-up while the probe lands; it shrinks at any force, or it would keep an error for good.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import UniformGravityFieldElement

from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require,
)


@dataclass(kw_only=True)
class ForceControllerParameters:
    """Parameters of the force law.

    Parameters
    ----------
    force
        Force to hold, in N.
    proportional_gain
        Proportional gain, in m/s/N. Its product with the contact's stiffness is the loop's
        bandwidth: 0.03 x 1000 N/m is 30/s.
    integral_gain
        Integral gain, in m/s/(N s).
    filter_time
        Time constant of the low-pass filter on the measured force, in s.
    touch_force, release_force
        Forces above which contact begins and below which it ends, in N.
    integral_band
        Largest error at which the integral grows, in N.
    approach_speed
        Highest speed towards the phantom, and the speed of the approach before contact, in m/s. It
        limits the force of landing.
    retreat_speed
        Highest speed away from the phantom, in m/s.
    """

    force: Positive = 2.0
    proportional_gain: Positive = 0.02
    integral_gain: NotNegative = 0.1
    filter_time: NotNegative = 0.02
    touch_force: Positive = 0.4
    release_force: Positive = 0.2
    integral_band: NotNegative = 0.5
    approach_speed: Positive = 0.01
    retreat_speed: Positive = 0.05

    def __post_init__(self) -> None:
        check_bounds(self)
        order = self.release_force <= self.touch_force < self.force
        require(order, "touch_force", self.touch_force, "at least release_force and below force")


class ForceState(NamedTuple):
    """Filtered force in N, velocity by the integral in m/s, and whether there is contact."""

    force: float = 0.0
    integral: float = 0.0
    in_contact: bool = False


def pressing_force(wrist_force: SpatialForce, X_WP: RigidTransform, mass: float) -> float:
    """Return the force with which the probe presses along its Y axis, in N.

    At rest, the arm's force on the probe (in P), the weight of its `mass` in kg and the contact
    force balance; in motion the result also contains the inertial force.
    """
    down_P = -X_WP.GetAsMatrix34().item(2, 1)
    weight = mass * UniformGravityFieldElement.kDefaultStrength
    return float(wrist_force.get_coeffs().item(4) + weight * down_P)


def approach_velocity(state: ForceState, parameters: ForceControllerParameters) -> float:
    """Return the velocity along the probe's Y axis, in m/s; a positive one presses harder."""
    if not state.in_contact:
        return parameters.approach_speed
    error = parameters.force - state.force
    velocity = parameters.proportional_gain * error + state.integral
    return min(max(velocity, -parameters.retreat_speed), parameters.approach_speed)


def next_state(
    state: ForceState,
    force: float,
    time_step: float,
    parameters: ForceControllerParameters,
    *,
    held: bool = False,
) -> ForceState:
    """Return the state after one more measured force in N, `time_step` seconds later.

    A force that is not a number leaves the state unchanged. While the probe is held by somebody
    else, whatever the law wants, the integral is zero.
    """
    if not math.isfinite(force):
        return state
    filtered = state.force + (force - state.force) * time_step / (
        parameters.filter_time + time_step
    )
    threshold = parameters.release_force if state.in_contact else parameters.touch_force
    if filtered <= threshold:
        return ForceState(force=filtered)
    error = parameters.force - filtered
    if held:
        return ForceState(filtered, 0.0, True)
    change = parameters.integral_gain * error * time_step
    if abs(error) < parameters.integral_band:
        return ForceState(filtered, state.integral + change, True)
    if error * state.integral < 0:
        left = max(abs(state.integral) - abs(change), 0.0)
        return ForceState(filtered, math.copysign(left, state.integral), True)
    return ForceState(filtered, state.integral, True)
