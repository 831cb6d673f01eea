"""Localization in a volume as published, with nothing added to it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.chatelain2013.method.intensity_drop import intensity_drops
from sonoservo.diagrams.papers.chatelain2013.method.local_optimization import optimize_locally
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import (
    LocalizationAttempt,
    LocalizationExplanation,
    SearchRegion,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis import Axis, axis_through
from sonoservo.systems.tracking.candidates import select_candidates
from sonoservo.systems.tracking.ransac import RansacParameters, ransac_axis
from sonoservo.systems.tracking.tip import TipParameters, axis_profile


def _published_ransac() -> RansacParameters:
    return RansacParameters(refits=1, draws_factor=1.0)


def _published_profile() -> TipParameters:
    return TipParameters(tube_radius=0.5e-3)


@dataclass(kw_only=True)
class PublishedLocalizationParameters:
    """Values of Chatelain 2013, section II-D. The paper publishes none of them.

    Values with the same meaning as in our method are the same as there; the others were chosen with
    fig. 5 on seeds from 100 on.

    Parameters
    ----------
    candidate_volume
        Total volume of the candidate voxels, which fixes their number ``|X_t|``, in m^3.
    margin
        Margin of the volume of interest around the predicted curve, also beyond its ends, in m.
    first_margin
        The same around the entry point, when nothing else is known about the needle, in m.
    max_angle_deg
        Largest angle alpha_0 from the predicted direction (eq. 22), in degrees.
    min_length
        Visible length from which on a needle is tracked, in m.
    max_gap
        Largest gap in the intensity along the needle that does not end it, in m.
    std
        Standard deviation of every coordinate of every control point, which gives the covariance R
        of eq. 7, in m.
    ransac
        Parameters of the random sample consensus. The refit of a straight needle is the published
        one. A bent one is optimized locally instead.
    profile
        Sampling of the intensity along the axis (step and radii of the tubes), and the end
        contrast, the drop at which the needle ends.
    """

    candidate_volume: float = 400e-9
    margin: float = 10e-3
    first_margin: float = 20e-3
    max_angle_deg: float = 35.0
    min_length: float = 10e-3
    max_gap: float = 3e-3
    std: float = 1e-3
    ransac: RansacParameters = field(default_factory=_published_ransac)
    profile: TipParameters = field(default_factory=_published_profile)

    def __post_init__(self) -> None:
        require_positive(
            candidate_volume=self.candidate_volume,
            margin=self.margin,
            first_margin=self.first_margin,
            max_angle_deg=self.max_angle_deg,
            min_length=self.min_length,
            max_gap=self.max_gap,
            std=self.std,
        )


def explain_published_localization(
    volume: Volume,
    prediction: NeedlePrediction | NotFound,
    parameters: PublishedLocalizationParameters,
    rng: np.random.Generator,
) -> LocalizationExplanation:
    """Localize the needle as in Chatelain 2013, section II-D; the volume counts as at once.

    A prediction without an entry stands for a detected insertion: its curve runs from the candidate
    entry point to the geometric median, and neither direction nor length of the needle are known.
    """
    if isinstance(prediction, NotFound):
        return LocalizationExplanation(volume.time, prediction, (), prediction)
    assert prediction.curve is not None
    first = prediction.entry is None
    margin = parameters.first_margin if first else parameters.margin
    angle = np.pi / 2 if first else np.deg2rad(parameters.max_angle_deg)
    region = SearchRegion(prediction.curve, margin, margin, margin, margin, float(angle))
    looked: dict[str, Any] = {}
    result = _localize(volume.at_once(), region, first, parameters, rng, looked)
    attempt = LocalizationAttempt(region, result, **looked)
    return LocalizationExplanation(volume.time, prediction, (attempt,), result)


def _localize(
    volume: Volume,
    region: SearchRegion,
    first: bool,
    parameters: PublishedLocalizationParameters,
    rng: np.random.Generator,
    looked: dict[str, Any],
) -> NeedleMeasurement | NotFound:
    """Localize the needle in a region, and store the intermediate results in ``looked``."""
    order = region.curve.order
    points = _candidates(volume, region, parameters)
    if isinstance(points, NotFound):
        return points
    looked.update(candidates=points, weights=np.ones(len(points)))
    ransac = parameters.ransac if order == 2 else replace(parameters.ransac, refits=0)
    found = ransac_axis(
        points,
        np.ones(len(points)),
        order=order,
        rng=rng,
        parameters=ransac,
        direction=None if first else region.curve.direction,
        max_angle=region.max_angle,
    )
    if isinstance(found, NotFound):
        return found
    looked.update(inliers=found.inliers)
    axis = found.fit.axis
    if order == 3:
        axis = optimize_locally(points[found.inliers], axis, max_bend=ransac.max_bend)
    ends = _ends(volume, axis, axis.abscissa(points[found.inliers]), region, parameters, looked)
    tip = axis.position(ends)
    entry = region.curve.entry
    if first and np.linalg.norm(tip[0] - entry) > np.linalg.norm(tip[1] - entry):
        ends = ends[::-1]
    length = float(abs(ends[1] - ends[0]))
    if first and length < parameters.min_length:
        return NotFound(f"only {1e3 * length:.1f} mm of the needle are visible")
    if length == 0:
        return NotFound("no intensity along the axis is above that of the surroundings")
    # Control points are uniform along the chord: the entry rests, the tip moves, no point slides.
    curve = NeedleCurve(axis.position(np.linspace(ends[0], ends[1], order)))
    covariance = parameters.std**2 * np.eye(3 * order)
    ratio = float(found.inliers.mean())
    return NeedleMeasurement(
        curve, covariance, volume.time, int(found.inliers.sum()), ratio, volume.X_WP
    )


def _candidates(
    volume: Volume,
    region: SearchRegion,
    parameters: PublishedLocalizationParameters,
) -> NDArray[np.float64] | NotFound:
    """Return (m, 3) brightest voxels of the volume of interest in W, in m (eq. 15)."""
    axis = axis_through(acquired_from(volume, region.curve.control_points))
    if isinstance(axis, NotFound):
        return axis
    start, stop = -region.before, region.curve.chord + region.beyond
    candidates = select_candidates(
        volume,
        axis,
        start=start,
        stop=stop,
        radius=region.radius,
        # One threshold T_t for the whole region, as in eq. 1.
        cross_section=parameters.candidate_volume / (stop - start),
        slab=stop - start,
    )
    if len(candidates.p_P) == 0:
        return NotFound("the predicted needle lies outside the field of view")
    return volume.to_world(candidates.p_P)[0]


def _ends(
    volume: Volume,
    axis: Axis,
    inliers: NDArray[np.float64],
    region: SearchRegion,
    parameters: PublishedLocalizationParameters,
    looked: dict[str, Any],
) -> NDArray[np.float64]:
    """Return (2,) abscissae of start and tip, where the intensity along the axis drops.

    The paper names no threshold: the end contrast above the median of the surroundings.
    """
    reach = np.sort(axis.abscissa(region.curve.control_points[[0, -1]]))
    start = min(reach[0] - region.before, inliers.min())
    stop = max(reach[1] + region.beyond, inliers.max())
    profile = axis_profile(volume, axis, start, stop, parameters.profile)
    looked.update(profile=profile)
    surroundings = np.median(profile.background[profile.seen]) if profile.seen.any() else 0.0
    bright = profile.seen & (profile.level > surroundings + parameters.profile.end_contrast)
    ends = intensity_drops(profile.a[bright], float(np.median(inliers)), parameters.max_gap)
    return np.array(ends)
