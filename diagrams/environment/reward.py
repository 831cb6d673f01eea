"""Reward of following a needle, from ground truth, and the ends of an episode."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RewardParameters:
    """Scales of the reward's terms, and the limits that end an episode.

    Parameters
    ----------
    length, angle
        Distance in m and angle in rad from the image at which a term has fallen to half.
    force
        Wanted contact force, and the error at which its term has fallen to half, in N.
    max_force
        Contact force in N above which an episode ends.
    lost_after
        Time in s after which an episode ends whose needle has left the field of view.
    reached
        Largest offset in m, and angle in rad, at which the needle counts as reached.
    reached_after
        Time in s for which it must stay so at the end of the insertion.
    """

    length: float = 5e-3
    angle: float = float(np.deg2rad(10))
    force: tuple[float, float] = (2.0, 1.0)
    max_force: float = 10.0
    lost_after: float = 3.0
    reached: tuple[float, float] = (1e-3, float(np.deg2rad(1)))
    reached_after: float = 1.0


def reward_terms(
    features: NDArray[np.float64], force: float, visible: bool, parameters: RewardParameters
) -> dict[str, float]:
    """Return the reward's terms, 0 to 1 each, of true features in m and rad and a force in N."""
    there = bool(np.isfinite(features).all()) and visible
    x, z, theta = features if there else np.full(3, np.inf)
    wanted, half = parameters.force
    return {
        "centred": _falling(np.hypot(x, z), parameters.length),
        "aligned": _falling(theta, parameters.angle),
        "in_view": float(there),
        "pressed": _falling(force - wanted, half),
    }


def _falling(error: float, half: float) -> float:
    return float(1 / (1 + (error / half) ** 2))
