"""Lower bound of the error with which a needle's final shape can be predicted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.curvature_wander import wander_modes

Floats = NDArray[np.float64]

_WIDE = 0.1  # standard deviation in m of the unknown origin, which leaves it free


@dataclass(frozen=True, kw_only=True)
class TrueBend:
    """True path of a needle, and what is known of all needles."""

    radius: float  # R in m
    angle: float  # first angle theta_0 in rad
    rotations: Sequence[float] = ()  # depths at which the bevel is turned, in m
    wander: float = 0.0  # standard deviation of the curvature, relative to its mean
    wander_length: float = 0.02
    radius_std: float = 0.6  # over all needles, in m
    angle_std: float = 0.0873  # over all needles, in rad


def deflection_bound(bend: TrueBend, seen: Floats, noise_std: float, depths: Floats) -> Floats:
    """Return the (k,) least standard deviations of a predicted deflection u, in m.

    Bayesian Cramer-Rao bound (Van Trees 1968) at the true path. The unknowns are the origin, R,
    theta_0 and the wander; an error of the plane does not change u to first order.
    """
    modes = wander_modes(float(depths[-1]), bend.rotations, bend.wander_length)
    prior = [_WIDE, bend.radius_std, bend.angle_std]
    prior += len(modes) * [bend.wander / bend.radius] if bend.wander else []
    scale = np.array(prior)

    def derivatives(at: Floats) -> Floats:
        steps = np.array([[0, 0], [1e-4, 0], [0, 1e-6]])
        shapes = np.array([1 / bend.radius, np.sin(bend.angle)]) + steps
        u, curved, turned = deflections(shapes, at, np.array(bend.rotations, dtype=float))
        radius = (u - curved) / 1e-4 / bend.radius**2
        columns = [np.ones(len(at)), radius, (turned - u) / 1e-6 * np.cos(bend.angle)]
        unknown = np.column_stack(columns)
        return np.hstack([unknown, modes.at(at)]) if bend.wander else unknown

    known = derivatives(seen) * scale
    information = known.T @ known / noise_std**2 + np.eye(len(scale))
    wanted = derivatives(depths) * scale
    variance = np.einsum("ki,ki->k", wanted, np.linalg.solve(information, wanted.T).T)
    return np.sqrt(variance)
