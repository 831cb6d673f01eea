"""Gate on the innovation: how far a measurement may be from its prediction."""

from functools import lru_cache

import numpy as np

from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.tracking.needle_filter import NeedleState


def innovation_distance(state: NeedleState, measurement: NeedleMeasurement) -> float:
    """Return the Mahalanobis distance of a measurement from a state predicted to its time.

    It is that of the nearest of the places where the tip may be.
    """
    points = state.curve.control_points.ravel()
    P = state.covariance[: len(points), : len(points)]
    away = [(z - points, P + R) for _, z, R in measurement.places]
    return float(np.sqrt(min(y @ np.linalg.solve(S, y) for y, S in away)))


@lru_cache
def gate_distance(gate: float, order: int) -> float:
    """Return the Mahalanobis distance that a true measurement exceeds with probability 1 - gate."""
    return float(np.sqrt(squared_distance(gate, 3 * order)))
