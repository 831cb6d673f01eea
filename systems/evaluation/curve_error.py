"""Distance between an estimated needle and the true one, over their whole length."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.distance import cdist

from sonoservo.systems.evaluation.run_errors import at_times
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.sweep import SweepGeometry

Floats = NDArray[np.float64]

_POINTS, _EVERY = 1001, 10
"""Points on each curve (0.1 mm apart on 100 mm), and the step between the points evaluated.

The tip is always among the points evaluated.
"""


def curve_deviations(log: RunLog, geometry: SweepGeometry) -> Floats:
    """Return the largest distance between the true and the estimated needle, after each volume.

    The true needle and the probe are taken at the time for which the estimate holds. Only the parts
    in the image count. The true needle counts from the estimated entry on, where it was first seen,
    because the estimate does not cover the part before.

    Returns (v,) distances in m; NaN if there is no estimate or no needle, or if either has no point
    in the image.
    """
    time = log.volume_estimate_time
    true = at_times(log, log.needle_points, time)
    poses = at_times(log, log.X_WP, time)
    result = np.full(len(time), np.nan)
    for k, estimate in enumerate(log.volume_estimate_points):
        if np.isfinite(estimate).all() and np.isfinite(true[k]).all():
            X_PW = np.linalg.inv(poses[k])
            curves = [points @ X_PW[:3, :3].T + X_PW[:3, 3] for points in (true[k], estimate)]
            result[k] = deviation(curves[0], NeedleCurve(curves[1]), geometry)
    return result


def deviation(true: Floats, estimate: NeedleCurve, geometry: SweepGeometry) -> float:
    """Return the largest distance between two curves in the image, in both directions, in m.

    It is NaN if either curve has no point in the image.
    """
    u = np.linspace(0, 1, _POINTS)
    truth, guess = CubicSpline(np.linspace(0, 1, len(true)), true)(u), estimate.position(u)
    first = int(np.argmin(np.linalg.norm(truth - guess[0], axis=1)))
    largest = [
        cdist(points[geometry.contains(points)], other).min(axis=1)
        for points, other in ((truth[first:][::-_EVERY], guess), (guess[::-_EVERY], truth))
    ]
    if not all(map(len, largest)):
        return float("nan")
    return float(np.concatenate(largest).max())
