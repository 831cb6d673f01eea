"""Leaf system that moves the probe along its axis to press with a constant force."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.tree import UniformGravityFieldElement
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require,
    require_positive,
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
        bandwidth: 0.02 x 1000 N/m is 20/s.
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

    A force that is not a number leaves the state unchanged. While the probe is held against the
    law, the integral is zero.
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


class ForceController(LeafSystem):
    """Presses with a constant force, and approaches the phantom whenever there is no contact.

    .. pydrake_system::

        name: ForceController
        input_ports:
        - wrist_force
        - X_WP
        - force_target (optional)
        - approach_scale (optional)
        - held (optional)
        output_ports:
        - approach_velocity
        - pressing_force

    v_y = K_p (F* - F) + K_i int (F* - F) dt, with F the filtered force of the probe along its Y
    axis, compensated for the probe's weight. `wrist_force` is the SpatialForce of the arm on the
    probe in P, and `X_WP` is a RigidTransform. `force_target` is F* in N and replaces the
    parameter's value, unless it is no number above the force of touch. `approach_scale` is a factor
    on the highest speed towards the phantom. While `held` is not zero, the arm does not follow the
    law, and the integral is zero.
    `approach_velocity` is v_y of P in P, in m/s, and `pressing_force` is F in N.

    Parameters
    ----------
    parameters
        Parameters of the force law.
    mass
        Mass carried by the sensor, in kg.
    time_step
        Period of the updates, in s.
    max_force
        Highest force in N to which `force_target` is cut.
    """

    def __init__(
        self,
        *,
        parameters: ForceControllerParameters,
        mass: float,
        time_step: float,
        max_force: float = math.inf,
    ):
        require_positive(mass=mass, time_step=time_step)
        super().__init__()
        self._parameters, self._max_force = parameters, max_force
        self._mass, self._time_step = mass, time_step
        self._wrist_force = self.DeclareAbstractInputPort("wrist_force", Value(SpatialForce()))
        self._X_WP = self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self._target = self.DeclareVectorInputPort("force_target", 1)
        self._scale = self.DeclareVectorInputPort("approach_scale", 1)
        self._held = self.DeclareVectorInputPort("held", 1)
        self.DeclareDiscreteState(3)
        state, settings = self.xd_ticket(), {self._target.ticket(), self._scale.ticket()}
        self.DeclareVectorOutputPort(
            "approach_velocity", 1, self._calc_approach_velocity, {state, *settings}
        )
        self.DeclareVectorOutputPort("pressing_force", 1, self._calc_pressing_force, {state})
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0, self._update_state)

    def _state(self, context: Context) -> ForceState:
        force, integral, in_contact = context.get_discrete_state(0).value().tolist()
        return ForceState(force, integral, bool(in_contact))

    def _parameters_now(self, context: Context) -> ForceControllerParameters:
        start = self._parameters
        target, scale = self._target, self._scale
        force = target.Eval(context).item() if target.HasValue(context) else start.force
        if not start.touch_force < force < math.inf:
            force = start.force
        force = min(force, self._max_force)
        factor = scale.Eval(context).item() if scale.HasValue(context) else 1.0
        if force == start.force and factor == 1.0:
            return start  # because replacing them costs another validation
        return replace(start, force=force, approach_speed=factor * start.approach_speed)

    def _update_state(self, context: Context, discrete_state: DiscreteValues) -> None:
        wrist_force, X_WP = self._wrist_force.Eval(context), self._X_WP.Eval(context)
        force = pressing_force(wrist_force, X_WP, self._mass)
        state = next_state(
            self._state(context),
            force,
            self._time_step,
            self._parameters_now(context),
            held=self._held.HasValue(context) and bool(self._held.Eval(context)[0]),
        )
        discrete_state.set_value(0, state)

    def _calc_approach_velocity(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, approach_velocity(self._state(context), self._parameters_now(context)))

    def _calc_pressing_force(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._state(context).force)
