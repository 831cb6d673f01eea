"""Whether the truth lies inside the 95 % that an estimate states, after each volume."""

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from sonoservo.systems.evaluation.run_errors import at_times, normalized_squared_errors
from sonoservo.systems.evaluation.run_log import RunLog, unit

Floats = NDArray[np.float64]

_WINDOW = 0.3
"""Time in s over which the tip's true velocity is taken; it averages out the hand's tremor."""


def inside_stated(log: RunLog, *, across_depth: bool = False) -> dict[str, list[bool | None]]:
    """Compare the errors of tip, axis and velocity with the uncertainty stated for them."""
    time = log.volume_estimate_time
    points = at_times(log, log.needle_points, time)
    before, after = (at_times(log, log.needle_tip, time + each / 2) for each in (-_WINDOW, _WINDOW))
    velocity = (after - before) / _WINDOW
    # For the parts that count, a projection on them and their number.
    across, number = np.broadcast_to(np.eye(3), (len(time), 3, 3)), 3
    if across_depth:
        depth = at_times(log, log.X_WP, time)[:, :3, 1]
        across, number = across - _outer(depth), 2
    true = _projected(across, points[:, -1] - points[:, points.shape[1] // 2])
    needle = log.volume_estimate_tip - log.volume_estimate_entry
    estimated = _projected(across, needle)
    # The direction turns in a plane across it, and in a projection further than in space.
    length = np.linalg.norm(estimated, axis=1) / np.linalg.norm(needle, axis=1)
    turn = length[:, np.newaxis] * (unit(estimated) - unit(true))
    aside = across - _outer(unit(estimated))
    axis = _inside(turn, log.volume_estimate_direction_covariance, aside, number - 1)
    ahead = np.sum(estimated * true, axis=1) > 0
    return {
        "tip": _inside(
            log.volume_estimate_tip - points[:, -1],
            log.volume_estimate_tip_covariance,
            across,
            number,
        ),
        "axis": [each and bool(right) for each, right in zip(axis, ahead, strict=True)],
        "velocity": _inside(
            log.volume_estimate_velocity - velocity,
            log.volume_estimate_velocity_covariance,
            across,
            number,
        ),
    }


def _inside(
    errors: Floats, covariances: Floats, projections: Floats, freedom: int
) -> list[bool | None]:
    """Compare the projections of (v, 3) errors with those of (v, 3, 3) covariances."""
    squared = normalized_squared_errors(
        _projected(projections, errors), projections @ covariances @ projections
    )
    limit = chi2.ppf(0.95, freedom)
    return [bool(each <= limit) if np.isfinite(each) else None for each in squared]


def _outer(directions: Floats) -> Floats:
    return directions[:, :, np.newaxis] * directions[:, np.newaxis, :]


def _projected(projections: Floats, vectors: Floats) -> Floats:
    return np.asarray(np.einsum("nij,nj->ni", projections, vectors))
