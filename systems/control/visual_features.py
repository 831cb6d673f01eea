"""Visual features of a needle in the probe frame, and the control law that drives them to zero.

Chatelain, Krupa and Marchal, "Real-time needle detection and tracking using a visually servoed 3D
ultrasound probe", ICRA 2013, section III.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


def needle_features(
    tip: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the features s = (X_tip, Z_tip, Theta) of a needle, in m, m and rad (eq. 23).

    `tip` is its (3,) position in P, in m, and `direction` of any length. Theta is the angle from
    the X axis to the Z axis of P. That is a negative right-handed rotation about Y, and eq. 27
    holds for this sign only. The sense of the direction does not matter, so Theta lies within
    +-90 deg.
    """
    x, _, z = tip.tolist()
    k_x, _, k_z = direction.tolist()
    if k_x < 0:
        k_x, k_z = -k_x, -k_z
    return np.array([x, z, math.atan2(k_z, k_x)])


def interaction_matrix(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (3, 3) matrix L_s that maps the probe's velocity to feature rates (eqs. 26, 27).

    The velocity is (v_x, v_z, omega_y) of P, in P. L_s is its own inverse.
    """
    x, z, _ = features.tolist()
    return np.array([[-1.0, 0.0, -z], [0.0, -1.0, x], [0.0, 0.0, 1.0]])


def servo_velocity(
    features: NDArray[np.float64], *, gain: float, rates: ArrayLike = 0.0, rotate: bool = True
) -> NDArray[np.float64]:
    """Return the velocity (v_x, v_z, omega_y) of P, in P, that brings the features to zero.

    v_c = -L_s^+ (gain e + rates) in m/s and rad/s (eqs. 24, 25), where e = s and the rates, zero in
    the paper, are those of the features while the probe is at rest. Without `rotate`, Theta is not
    controlled.
    """
    wanted = -(gain * features + np.asarray(rates))
    if not rotate:
        wanted[2] = 0
    return interaction_matrix(features) @ wanted


def saturated(
    velocity: NDArray[np.float64], *, speed: float, angular_speed: float
) -> NDArray[np.float64]:
    """Return a velocity (v_x, v_z, omega_y) scaled down as a whole to the highest speeds."""
    v_x, v_z, omega_y = velocity.tolist()
    excess = max(math.hypot(v_x, v_z) / speed, abs(omega_y) / angular_speed, 1)
    return velocity / excess
