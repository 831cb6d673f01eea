"""Volumes with a needle, and what a tracker makes of them."""

import numpy as np
from pydrake.math import RigidTransform
from synthetic_volumes import ENTRY, K, Scene

from sonoservo.systems.evaluation.explanation.explained_volume import explain_volume
from sonoservo.systems.signals import (
    LocalizationExplanation,
    NeedleCurve,
    NeedleEstimate,
    NeedlePrediction,
    TrackingMode,
    Volume,
)
from sonoservo.systems.tracking import NeedleLocalizerParameters
from sonoservo.systems.tracking.pipeline import explain_localization

SCENE = Scene(seed=5, spacing=1.2e-3)
NEEDLE = np.array([ENTRY, ENTRY + 30e-3 * K])


def estimate(time, mode=TrackingMode.TRACKING, tip=None, speed=0.0):
    """An estimate after the volume of a time; the tip moves along X."""
    if mode == TrackingMode.SEARCHING:
        return NeedleEstimate(mode, time, volume_time=time)
    curve = NeedleCurve(NEEDLE if tip is None else [ENTRY, tip])
    velocity = [[0, 0, 0], [speed, 0, 0]]
    return NeedleEstimate(mode, time, curve, velocity, 1e-6 * np.eye(12), time)


def predicted(shift=0.0):
    """A prediction beside the needle, by a shift along Z in m."""
    curve = NeedleCurve(NEEDLE + np.array([0, 0, shift]))
    return NeedlePrediction(2, 0.0, curve, np.zeros((2, 3)), 1e-6 * np.eye(6), curve.entry)


def look(volume, prediction):
    """What a localizer looks at in a volume."""
    rng = np.random.default_rng(0)
    return explain_localization(volume, prediction, NeedleLocalizerParameters(), rng)


def explained(*, found=True, occasion="tracking to coasting", prediction=None, number=0):
    """An explained volume, in which the needle is found or not."""
    volume = SCENE.volume(number, lambda t: NEEDLE if found else None)
    mode = TrackingMode.TRACKING if found else TrackingMode.COASTING
    return explain_volume(
        volume,
        look(volume, predicted() if prediction is None else prediction),
        before=estimate(-0.3),
        after=estimate(volume.time, mode),
        occasion=occasion,
    )


def small_volume(time):
    """A volume that shows nothing."""
    dark = np.zeros((3, 3, 3), np.uint8)
    return Volume(dark, -1e-2 * np.ones(3), 1e-2 * np.ones(3), RigidTransform(), time)


def empty_look(time, reason):
    """The explanation of a volume in which nothing was searched."""
    return LocalizationExplanation(time, reason, (), reason)
