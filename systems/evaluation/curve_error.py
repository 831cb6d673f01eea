"""How far an estimated needle lies from the true one, all along it."""

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
"""On each curve: 0.1 mm apart on 100 mm; the distance is taken from every tenth, tip included."""


def curve_deviations(log: RunLog, geometry: SweepGeometry) -> Floats:
    """Largest distance between true and estimated needle, after each volume.

    Truth and probe are those at the time for which the estimate holds. Only what lies in the image
    counts, and of the true needle only what follows the estimated entry, which is where it was
    first seen: an estimate says nothing of what lies before.

    Parameters
    ----------
    log
        Of the run.
    geometry
        Of the sweeps: tells what lies in the image.

    Returns
    -------
    (v,) distances in m; NaN where there is no estimate, no needle, or neither in the image.
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
    """Largest distance between two curves in the image, either way; NaN where there is nothing.

    Parameters
    ----------
    true
        (m, 3) points evenly spaced along the true needle in P, entry first, in m.
    estimate
        In P, in m.
    geometry
        Of the sweep.
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
