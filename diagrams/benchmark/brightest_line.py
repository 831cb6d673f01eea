"""A tracker of forty lines: the line through the voxels that brightened since the probe rests."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import uniform_filter

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.volume import Volume

BRIGHTEST, BRIGHTER = 60, 15
"""Number of voxels through which the line is laid, and by how many grey levels they brightened."""


def make() -> Callable[[Volume], NeedleEstimate]:
    """Return a tracker: a function from the next volume to the estimate after it."""
    kept: list[Volume] = []

    def track(volume: Volume) -> NeedleEstimate:
        if not kept or not kept[0].X_WP.IsNearlyEqualTo(volume.X_WP, 1e-3):
            kept[:] = [volume]  # the probe moved: what brightens is counted from here
        change = np.subtract(volume.intensities, kept[0].intensities, dtype=np.float32)
        grown = uniform_filter(change, 5)[::2, ::2, ::2]
        places = np.argpartition(grown.ravel(), -BRIGHTEST)[-BRIGHTEST:]
        index = 2 * np.stack(np.unravel_index(places, grown.shape), axis=1)
        points = volume.origin + volume.spacing * index  # in P, in m
        middle = np.median(points, axis=0)
        _, spread, axes = np.linalg.svd(points - middle, full_matrices=False)
        if spread[0] < 3 * spread[1] or grown.ravel()[places].min() < BRIGHTER:
            return NeedleEstimate(
                TrackingMode.SEARCHING, volume.time, volume_time=volume.time, reason="no line"
            )
        along = (points - middle) @ axes[0]
        ends = middle + np.outer(np.percentile(along, [2, 98]), axes[0])
        # The needle comes in from outside: its tip is the end nearer to the middle of the image.
        entry, tip = sorted(ends, key=lambda end: -np.hypot(end[0], end[2]))
        return NeedleEstimate(
            TrackingMode.TRACKING,
            time=volume.time,
            curve=NeedleCurve(volume.X_WP.multiply(np.array([entry, tip]).T).T),
            velocity=np.zeros((2, 3)),  # a guess: at rest
            covariance=np.diag(np.repeat([1e-6, 1e-4], 6)),  # a guess: 1 mm, 10 mm/s
            volume_time=volume.time,
            probability=0.5,
        )

    return track
