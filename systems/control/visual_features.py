"""The needle as visual features of the probe, and the law that drives them to zero.

Chatelain, Krupa and Marchal, "Real-time needle detection and tracking using a visually servoed 3D
ultrasound probe", ICRA 2013, section III.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


def needle_features(
    tip: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Features s = (X_tip, Z_tip, Theta) of a needle (eq. 23).

    Theta is the angle from the X to the Z axis of P: a negative right-handed turn about Y, for
    which alone eq. 27 holds. A needle has no front here, so Theta lies within +-90 deg.

    Parameters
    ----------
    tip
        (3,) position in P, in m.
    direction
        (3,) direction in P, of any length; either way along the needle.

    Returns
    -------
    (3,) X and Z in m, Theta in rad.
    """
    x, _, z = tip.tolist()
    k_x, _, k_z = direction.tolist()
    if k_x < 0:
        k_x, k_z = -k_x, -k_z
    return np.array([x, z, math.atan2(k_z, k_x)])


def interaction_matrix(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) matrix L_s that maps the probe's velocity to the features' rates (eqs. 26, 27).

    The velocity is (v_x, v_z, omega_y) of P, in P. L_s is its own inverse.
    """
    x, z, _ = features.tolist()
    return np.array([[-1.0, 0.0, -z], [0.0, -1.0, x], [0.0, 0.0, 1.0]])


def servo_velocity(
    features: NDArray[np.float64], *, gain: float, rates: ArrayLike = 0.0, rotate: bool = True
) -> NDArray[np.float64]:
    """Velocity of the probe that brings the features to zero (eqs. 24, 25).

    v_c = -L_s^+ (gain e + rates), with e = s: the wanted features are zero, and `rates` is what
    the features change by while the probe stands still (zero in the paper).

    Parameters
    ----------
    features
        (3,) s, in m, m, rad.
    gain
        lambda, in 1/s.
    rates
        (3,) in m/s, m/s, rad/s, or zero.
    rotate
        False leaves Theta alone, for a needle along the beam whose Theta means nothing.

    Returns
    -------
    (3,) velocity (v_x, v_z, omega_y) of P, in P, in m/s and rad/s.
    """
    wanted = -(gain * features + np.asarray(rates))
    if not rotate:
        wanted[2] = 0
    return interaction_matrix(features) @ wanted


def saturated(
    velocity: NDArray[np.float64], *, speed: float, angular_speed: float
) -> NDArray[np.float64]:
    """Velocity (v_x, v_z, omega_y) slowed down, as a whole, to the highest allowed speeds."""
    v_x, v_z, omega_y = velocity.tolist()
    excess = max(math.hypot(v_x, v_z) / speed, abs(omega_y) / angular_speed, 1)
    return velocity / excess


def significant_velocity(velocity: NDArray[np.float64], min_speed: float) -> NDArray[np.float64]:
    """Estimated velocity where it stands out of its noise, zero where it does not.

    A filter's velocity is never quite zero, and following its noise would shake a probe that ought
    to rest. A velocity is passed on unchanged from twice `min_speed`, not at all below it, and
    in proportion in between, without a jump. (Its covariance does not tell noise from motion: a
    filter that allows for sudden starts is unsure of the velocity even where it hardly scatters.)

    Parameters
    ----------
    velocity
        (3,) in m/s.
    min_speed
        In m/s; zero passes everything on.
    """
    speed = math.hypot(*velocity.tolist())
    if speed >= 2 * min_speed:
        return velocity
    return velocity * max(speed / min_speed - 1, 0)
