"""Gate on the innovation: how far a measurement may be from its prediction."""

from functools import lru_cache

import numpy as np

from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.tracking.needle_filter import NeedleState


def innovation_distance(state: NeedleState, measurement: NeedleMeasurement) -> float:
    """Return the Mahalanobis distance of a measurement from a state predicted to its time."""
    points = state.curve.control_points.ravel()
    y = measurement.curve.control_points.ravel() - points
    S = state.covariance[: len(points), : len(points)] + measurement.total_covariance
    return float(np.sqrt(y @ np.linalg.solve(S, y)))


@lru_cache
def gate_distance(gate: float, order: int) -> float:
    """Return the Mahalanobis distance that a true measurement exceeds with probability 1 - gate."""
    return float(np.sqrt(squared_distance(gate, 3 * order)))
