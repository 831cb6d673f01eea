"""A tracker of forty lines: the line through the brightest voxels of what came since the start."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.volume import Volume

BRIGHTEST = 400
"""Number of voxels through which the line is laid."""


def make() -> Callable[[Volume], NeedleEstimate]:
    """Return a tracker: a function from the next volume to the estimate after it."""
    first: list[Volume] = []

    def track(volume: Volume) -> NeedleEstimate:
        first.append(volume)
        del first[1:]
        grown = np.asarray(volume.intensities, float) - first[0].intensities
        grown = gaussian_filter(grown, 1.0)
        places = np.argpartition(grown.ravel(), -BRIGHTEST)[-BRIGHTEST:]
        index = np.stack(np.unravel_index(places, grown.shape), axis=1)
        points = volume.origin + volume.spacing * index  # in P, in m
        middle = np.median(points, axis=0)
        _, spread, axes = np.linalg.svd(points - middle, full_matrices=False)
        if spread[0] < 4 * spread[1] or grown.ravel()[places].min() < 30:
            return NeedleEstimate(
                TrackingMode.SEARCHING, volume.time, volume_time=volume.time, reason="no line"
            )
        along = (points - middle) @ axes[0]
        ends = middle + np.outer(np.percentile(along, [2, 98]), axes[0])
        # The probe sees the needle come in from outside: the tip is the end nearer to the middle.
        entry, tip = sorted(ends, key=lambda end: -np.hypot(end[0], end[2]))
        return NeedleEstimate(
            TrackingMode.TRACKING,
            time=volume.time,
            curve=NeedleCurve(volume.X_WP.multiply(np.array([entry, tip]).T).T),
            velocity=np.zeros((2, 3)),
            covariance=np.diag(np.repeat([1e-6, 1e-4], 6)),
            volume_time=volume.time,
            probability=0.5,
        )

    return track
