"""Published localization in a whole volume without a prediction: thresholding, RANSAC, tip."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.chatelain2013.method.localization import (
    intensity_drops,
    least_length,
)
from sonoservo.systems.sampling.kernels import chosen_ties
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import LocalizationExplanation
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.requirements import Positive, check_bounds, require_positive
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis_fit import AxisFit
from sonoservo.systems.tracking.ransac import RansacParameters, ransac_axis
from sonoservo.systems.tracking.tip import TipParameters, axis_profile


@dataclass(kw_only=True)
class WholeVolumeRansacParameters:
    """Parameters of the four steps of Zhao 2012, section 2.2. The paper publishes no values.

    Parameters
    ----------
    candidate_volume
        Total volume of the brightest voxels, in m^3.
    max_gap
        Largest gap in the intensity along the needle that does not end it, in m.
    end_contrast
        Intensity above the median of the surroundings at which the needle ends, in dB. None stands
        for half the amplitude of the needle around its middle, which suits an echo that is even
        along the needle.
    ransac, tip
        Parameters of the axis and of the intensity along it. Without refits the axis is that of the
        best sample. With one it is optimized locally, as published.
    """

    candidate_volume: Positive = 60e-9
    max_gap: Positive = 2e-3
    end_contrast: float | None = None
    ransac: RansacParameters = field(default_factory=RansacParameters)
    tip: TipParameters = field(default_factory=TipParameters)

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.end_contrast is not None:
            require_positive(end_contrast=self.end_contrast)


@dataclass(kw_only=True)
class WholeVolumeLocalizationParameters(WholeVolumeRansacParameters):
    """Values of Zhao 2012's localization in a loop; see `WholeVolumeRansacParameters`.

    Parameters
    ----------
    min_length
        Visible length from which on a needle is tracked, in m; see `least_length`.
    std
        Standard deviation of the tip and the rear end in every direction, which gives the
        covariance R of eq. 3, in m.
    """

    min_length: Positive = 20e-3
    std: Positive = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()


@dataclass(frozen=True, eq=False)
class WholeVolumeNeedle:
    """A straight needle in W: fit of its axis, and abscissae between which it is seen, in m."""

    fit: AxisFit
    start: float
    tip: float

    def measurement(self, time: float, std: float, independent: float) -> NeedleMeasurement:
        """Return the measurement with which a track can start."""
        ends = np.array([self.start, self.tip])
        covariance = self.fit.covariance(ends, independent) + std**2 * np.eye(6)
        curve = NeedleCurve(self.fit.axis.position(ends))
        return NeedleMeasurement(curve, covariance, time, 0, 0.0)


def brightest_voxels(volume: Volume, count: int) -> NDArray[np.int64]:
    """Return the (count, 3) indices of the brightest voxels; equal ones count by `chosen_ties`."""
    values = volume.intensities.ravel()
    if values.dtype == np.uint8:
        above = np.cumsum(np.bincount(values, minlength=256)[::-1])[::-1]
        least = np.flatnonzero(above >= count)[-1]
    else:
        least = np.partition(values, -count)[-count]
    brighter, equal = np.flatnonzero(values > least), np.flatnonzero(values == least)
    chosen = np.concatenate([brighter, chosen_ties(equal, count - len(brighter))])
    return np.stack(np.unravel_index(chosen, volume.intensities.shape), axis=1)


def localize_in_whole_volume(
    volume: Volume,
    towards: NDArray[np.float64],
    parameters: WholeVolumeRansacParameters,
    rng: np.random.Generator,
) -> WholeVolumeNeedle | NotFound:
    """Localize the needle in a whole volume as published (Zhao 2012, section 2.2; Uhercik 2010).

    The axis is the line through two of the brightest voxels that has the most others nearby,
    optimized on those. The intensity along it ends at the tip, but for tolerated gaps. ``towards``
    is the needle's rough (3,) direction in W.
    """
    if volume.intensities.min() == volume.intensities.max():
        return NotFound("the volume is constant")
    count = round(parameters.candidate_volume / float(np.prod(volume.spacing)))
    count = min(count, volume.intensities.size)
    index = brightest_voxels(volume, count)
    points = volume.to_world(volume.position(index))[0]
    found = ransac_axis(
        points,
        np.ones(count),
        order=2,
        rng=rng,
        parameters=parameters.ransac,
        direction=towards / np.linalg.norm(towards),
    )
    if isinstance(found, NotFound):
        return found
    axis = found.fit.axis
    a = np.sort(axis.abscissa(points[found.inliers]))
    middle = float(np.median(a))
    profile = axis_profile(volume, axis, a[0], a[-1], parameters.tip)
    if parameters.end_contrast is None:
        inside = np.abs(profile.a - middle) <= parameters.max_gap
        least = float(np.median(profile.level[inside])) - 20 * np.log10(2)
    else:
        around = profile.background[profile.seen]
        least = float(np.median(around)) + parameters.end_contrast if len(around) else 0.0
    bright = profile.level > least
    start, tip = intensity_drops(profile.a[bright], middle, parameters.max_gap)
    if tip - start < parameters.tip.step:
        return NotFound("the axis is bright at no more than one point")
    return WholeVolumeNeedle(found.fit, start, tip)


def explain_whole_volume_localization(
    volume: Volume,
    prediction: NeedlePrediction | NotFound,
    parameters: WholeVolumeLocalizationParameters,
    rng: np.random.Generator,
) -> LocalizationExplanation:
    """Localize the needle by `localize_in_whole_volume`, towards the prediction's direction."""
    if isinstance(prediction, NotFound):
        return LocalizationExplanation(volume.time, prediction, (), prediction)
    assert prediction.curve is not None
    towards = prediction.curve.direction
    found = localize_in_whole_volume(volume.at_once(), towards, parameters, rng)
    result: NeedleMeasurement | NotFound
    if isinstance(found, NotFound):
        result = found
    elif found.tip - found.start < least_length(prediction.entry is None, parameters.min_length):
        result = NotFound(f"only {1e3 * (found.tip - found.start):.1f} mm of a needle are visible")
    else:
        curve = NeedleCurve(found.fit.axis.position(np.array([found.start, found.tip])))
        covariance = parameters.std**2 * np.eye(6)
        result = NeedleMeasurement(curve, covariance, volume.time, 0, 0.0, volume.X_WP)
    return LocalizationExplanation(volume.time, prediction, (), result)
