"""Leaf: where the probe should go so that the needle lies centred and along the image."""

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
    significant_velocity,
)
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive


@dataclass(kw_only=True)
class VisualServoParameters:
    """How the probe follows the needle.

    Parameters
    ----------
    gain
        lambda of eq. 25, in 1/s: errors fall to a third in a time constant of 1 / gain. Features
        held as they were in a volume one period T old would allow 1 / T at most, 3.3/s at 3.3
        volumes/s; an estimate in W is seen from where the probe is now and has no such limit. Zero
        switches all visual motion off.
    feed_forward
        Whether the probe moves with the tip's estimated velocity while the needle is seen (not
        while the estimate coasts); off in the paper, where the tip lags by its velocity / gain.
    min_speed
        Slower than this, in m/s, that velocity counts as noise and is not followed; from twice
        this speed it is followed in full. Zero follows it always.
    min_inclination_deg
        A needle closer than this to the beam leaves the probe's rotation alone, in deg.
    stale_after
        An estimate older than this stops the visual motion, in s.
    max_speed, max_angular_speed_deg
        Highest speeds asked for, in m/s and deg/s.
    """

    gain: float = 1.6
    feed_forward: bool = True
    min_speed: float = 1.5e-3
    min_inclination_deg: float = 10.0
    stale_after: float = 1.5
    max_speed: float = 0.03
    max_angular_speed_deg: float = 20.0

    def __post_init__(self) -> None:
        require_positive(
            stale_after=self.stale_after,
            max_speed=self.max_speed,
            max_angular_speed_deg=self.max_angular_speed_deg,
        )
        require_not_negative(
            gain=self.gain,
            min_speed=self.min_speed,
            min_inclination_deg=self.min_inclination_deg,
        )


def planar_velocity(
    estimate: NeedleEstimate, X_WP: RigidTransform, time: float, parameters: VisualServoParameters
) -> NDArray[np.float64]:
    """Velocity of the probe in its own X-Z plane that follows an estimated needle.

    Parameters
    ----------
    estimate
        In W, for its own time. Visual motion stops where nothing is tracked or it is stale.
    X_WP
        Pose of the probe now.
    time
        Now, in s: with feed-forward the needle is carried on to it.
    parameters
        Of the law.

    Returns
    -------
    (3,) velocity (v_x, v_z, omega_y) of P, in P, in m/s and rad/s.
    """
    age = max(time - estimate.time, 0)
    followed = estimate.mode in (TrackingMode.TRACKING, TrackingMode.COASTING)
    fresh = age <= parameters.stale_after
    if estimate.curve is None or not followed or not fresh or parameters.gain == 0:
        return np.zeros(3)

    R_PW = X_WP.rotation().matrix().T
    tip = estimate.curve.tip - X_WP.translation()
    rates = np.zeros(3)
    if parameters.feed_forward and estimate.mode is TrackingMode.TRACKING:
        velocity = significant_velocity(estimate.tip_velocity, parameters.min_speed)
        tip = tip + age * velocity
        rates[:2] = (R_PW @ velocity)[[0, 2]]

    direction = R_PW @ estimate.curve.direction
    inclination = math.hypot(direction[0], direction[2])
    velocity = servo_velocity(
        needle_features(R_PW @ tip, direction),
        gain=parameters.gain,
        rates=rates,
        rotate=inclination > math.sin(math.radians(parameters.min_inclination_deg)),
    )
    return saturated(
        velocity,
        speed=parameters.max_speed,
        angular_speed=math.radians(parameters.max_angular_speed_deg),
    )


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

    v_c = -L_s^+ (lambda s + rates), s = (X_tip, Z_tip, Theta); `estimate` is a NeedleEstimate,
    `X_WP` a RigidTransform, `gain` lambda in 1/s in place of the parameter's, `planar_velocity` is
    (v_x, v_z, omega_y) of P, in P, in m/s and rad/s. It has no state: between two estimates the
    features still follow the probe's own motion, and with feed-forward the needle's.

    Parameters
    ----------
    parameters
        Of the law.
    """

    def __init__(self, *, parameters: VisualServoParameters):
        super().__init__()
        self._parameters = parameters
        self.DeclareAbstractInputPort("estimate", Value[object]())
        self.DeclareAbstractInputPort("X_WP", Value(RigidTransform()))
        self.DeclareVectorInputPort("gain", 1)
        self.DeclareVectorOutputPort("planar_velocity", 3, self._calc_planar_velocity)

    def _calc_planar_velocity(self, context: Context, output: BasicVector) -> None:
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        X_WP = evaluate(self, context, "X_WP", RigidTransform)
        parameters, port = self._parameters, self.GetInputPort("gain")
        gain = float(port.Eval(context)[0]) if port.HasValue(context) else parameters.gain
        if gain != parameters.gain:  # a new one is checked anew, which takes its time
            parameters = replace(parameters, gain=gain)
        output.SetFromVector(planar_velocity(estimate, X_WP, context.get_time(), parameters))
