"""Leaf system that moves the probe to centre the needle and align it with the image."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from sonoservo.systems.control.visual_features import (
    needle_features,
    saturated,
    servo_velocity,
)
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate_port
from sonoservo.systems.signals.requirements import Bounded, NotNegative, Positive

_FOLLOWED = (TrackingMode.TRACKING, TrackingMode.COASTING)  # Modes in which an estimate is followed


@dataclass(kw_only=True)
class VisualServoParameters(Bounded):
    """Parameters of the visual servo.

    Parameters
    ----------
    gain
        Gain lambda of eq. 25, in 1/s: errors fall to a third in a time constant of 1 / gain. If the
        features were held from a volume that is one period T old, the gain could be 1 / T at most,
        which is 3.3/s at 3.3 volumes/s. An estimate in W is seen from the probe's present pose and
        has no such limit. Zero switches all visual motion off.
    feed_forward
        Whether the probe moves with the tip's estimated velocity while the needle is seen, but not
        while the estimate coasts. It is off in the paper, and the tip then lags by its
        velocity / gain.
    min_inclination_deg
        Smallest angle between the needle and the beam at which the probe rotates, in deg.
    stale_after
        Age of an estimate above which the visual motion stops, in s.
    max_tip_std
        Standard deviation of the tip, the root of its covariance's trace, above which the estimate
        is not followed, in m. A needle that reaches out of the volume is known to about 10 mm.
    max_speed, max_angular_speed_deg
        Highest commanded speeds, in m/s and deg/s.
    held
        Whether the command of a volume is held until the next one, as in the paper. That needs a
        tracker that keeps the needle in the probe's frame. Otherwise the needle is kept in W and
        seen from the probe's present pose.
    """

    gain: NotNegative = 1.6
    feed_forward: bool = True
    min_inclination_deg: NotNegative = 10.0
    stale_after: Positive = 1.5
    max_tip_std: Positive = 0.025
    max_speed: Positive = 0.03
    max_angular_speed_deg: Positive = 20.0
    held: bool = False


def hold_reason(estimate: NeedleEstimate, time: float, parameters: VisualServoParameters) -> str:
    """Return the reason why a tracked needle is not followed; empty if it is or none is tracked."""
    if estimate.mode not in _FOLLOWED or estimate.curve is None:
        return ""
    age = time - estimate.time
    if not abs(age) <= parameters.stale_after:
        return f"the estimate is {age:.1f} s old"
    if estimate.tip_std > parameters.max_tip_std:
        return f"the tip is uncertain by {1e3 * estimate.tip_std:.0f} mm"
    return ""


def planar_velocity(
    estimate: NeedleEstimate, X_WP: RigidTransform, time: float, parameters: VisualServoParameters
) -> NDArray[np.float64]:
    """Return the (3,) velocity (v_x, v_z, omega_y) of P, in P, that follows a needle.

    Visual motion stops if nothing is tracked, and for the reasons of `hold_reason`. With
    feed-forward, the tip is extrapolated to the present time in s.
    """
    followed = estimate.mode in _FOLLOWED and parameters.gain != 0
    if estimate.curve is None or not followed or hold_reason(estimate, time, parameters):
        return np.zeros(3)

    if parameters.held and estimate.X_WP is not None:
        X_WP = estimate.X_WP
    age = max(time - estimate.time, 0)
    X = X_WP.GetAsMatrix34()
    R_PW, p_WP = X[:, :3].T, X[:, 3]
    tip = estimate.curve.tip - p_WP
    rates = np.zeros(3)
    if parameters.feed_forward and estimate.mode is TrackingMode.TRACKING:
        velocity = estimate.tip_velocity
        tip = tip + age * velocity
        rates[:2] = (R_PW @ velocity)[::2]

    direction = R_PW @ estimate.curve.direction
    inclination = math.hypot(direction[0], direction[2])
    velocity = servo_velocity(
        needle_features(R_PW @ tip, direction),
        gain=parameters.gain,
        rates=rates,
        rotate=inclination > math.sin(math.radians(parameters.min_inclination_deg)),
    )
    turning = math.radians(parameters.max_angular_speed_deg)
    return saturated(velocity, speed=parameters.max_speed, angular_speed=turning)


class VisualServo(LeafSystem):
    """Centres the needle's tip and aligns its axis with the image (Chatelain 2013, eqs. 23-27).

    .. pydrake_system::

        name: VisualServo
        input_ports:
        - estimate
        - X_WP
        - gain (optional)
        output_ports:
        - planar_velocity
        - hold_reason

    v_c = -L_s^+ (lambda s + rates), with s = (X_tip, Z_tip, Theta). `estimate` is a NeedleEstimate
    and `X_WP` a RigidTransform. `gain` is lambda in 1/s and replaces the parameter's value;
    nothing is followed unless it is a number of at least 0.
    `planar_velocity` is (v_x, v_z, omega_y) of P, in P, in m/s and rad/s. `hold_reason` tells why a
    tracked needle is not followed; it is an empty text otherwise. The system has no state. Between
    two estimates the features still follow the probe's own motion, and with feed-forward the
    needle's.

    Parameters
    ----------
    parameters
        Parameters of the visual servo.
    """

    def __init__(self, *, parameters: VisualServoParameters):
        super().__init__()
        self._parameters = parameters
        declare_inputs(self, estimate=NeedleEstimate)
        self._estimate = self.GetInputPort("estimate")
        self._X_WP = self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self._gain = self.DeclareVectorInputPort("gain", 1)
        self.DeclareVectorOutputPort("planar_velocity", 3, self._calc_planar_velocity)
        read = {self._estimate.ticket(), self._gain.ticket(), self.time_ticket()}
        declare_output(self, "hold_reason", str, self._calc_hold_reason, read)

    def _gain_now(self, context: Context) -> float:
        """Return the gain in 1/s, or NaN if what the port says is none."""
        if not self._gain.HasValue(context):
            return self._parameters.gain
        gain = float(self._gain.Eval(context)[0])
        return gain if 0 <= gain < math.inf else math.nan

    def _calc_planar_velocity(self, context: Context, output: BasicVector) -> None:
        estimate = evaluate_port(self._estimate, context, NeedleEstimate)
        parameters, gain = self._parameters, self._gain_now(context)
        if gain != gain:
            output.SetFromVector(np.zeros(3))
            return
        if gain != parameters.gain:  # because replacing them costs another validation
            parameters = replace(parameters, gain=gain)
        X_WP = self._X_WP.Eval(context)
        output.SetFromVector(planar_velocity(estimate, X_WP, context.get_time(), parameters))

    def _calc_hold_reason(self, context: Context, output: Value) -> None:
        estimate = evaluate_port(self._estimate, context, NeedleEstimate)
        if math.isnan(self._gain_now(context)):
            output.set_value("the gain is not a number of at least 0")
            return
        output.set_value(hold_reason(estimate, context.get_time(), self._parameters))
