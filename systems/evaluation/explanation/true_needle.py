"""The true needle as a volume shows it."""

import numpy as np

from sonoservo.systems.evaluation.explanation.explained_volume import ExplainedVolume
from sonoservo.systems.evaluation.log import Array
from sonoservo.systems.evaluation.run_errors import at_times
from sonoservo.systems.evaluation.run_log import RunLog

_POINTS_EACH = 4
"""Number of segments between neighbouring points of the log."""


def imaged_needle(log: RunLog, explained: ExplainedVolume) -> Array:
    """Return the true needle as a volume shows it, with each point at the time of its acquisition.

    Parameters
    ----------
    log
        Log of the run.
    explained
        Volume of the run.

    Returns
    -------
    (m, 3) points along the needle in P, entry to tip, in m; none if it is outside the tissue or
    unknown.
    """
    logged = np.linspace(0, 1, log.needle_points.shape[1])
    u = np.linspace(0, 1, _POINTS_EACH * (len(logged) - 1) + 1)
    times = np.full(len(u), float(explained.volume_time))
    p_P = np.zeros((0, 3))
    for _ in range(3):  # position and time of a point's acquisition depend on each other
        needles = at_times(log, log.needle_points, times)
        if not np.isfinite(needles).all():
            return np.zeros((0, 3))
        points = [
            [np.interp(each, logged, axis) for axis in needle.T]
            for each, needle in zip(u, needles, strict=True)
        ]
        p_P = explained.to_probe(np.array(points))
        if explained.motion is None:
            break
        times = explained.motion.to_world(p_P)[1]
    return p_P
