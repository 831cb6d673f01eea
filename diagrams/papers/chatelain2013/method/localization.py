"""Localization in a volume as published, with nothing added to it."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import (
    LocalizationAttempt,
    LocalizationExplanation,
    SearchRegion,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.requirements import Bounded, Positive
from sonoservo.systems.signals.volume import Volume, acquired_from
from sonoservo.systems.tracking.axis import Axis, axis_through
from sonoservo.systems.tracking.candidates import select_candidates
from sonoservo.systems.tracking.ransac import RansacParameters, ransac_axis
from sonoservo.systems.tracking.tip import TipParameters, axis_profile

_FIRST_STEP = 0.5e-3
"""Displacement of one coordinate of a control point in the first simplex, in m."""

_TOLERANCE = 5e-6
"""Size of the simplex in m at which the search ends."""


def _published_ransac() -> RansacParameters:
    return RansacParameters(refits=1, draws_factor=1.0)


def _published_profile() -> TipParameters:
    return TipParameters(tube_radius=0.5e-3)


@dataclass(kw_only=True)
class PublishedLocalizationParameters(Bounded):
    """Values of Chatelain 2013, section II-D. The paper publishes none of them.

    Values with the same meaning as in our method are the same as there; the others were chosen with
    fig. 5 on seeds from 100 on.

    Parameters
    ----------
    candidate_volume
        Total volume of the candidate voxels, which fixes their number ``|X_t|``, in m^3.
    margin
        Margin of the volume of interest around the predicted curve, or around the entry point, when
        nothing else is known about the needle, in m; also beyond its ends. From one volume to the
        next, the phantom of fig. 6 moves by as much.
    max_angle_deg
        Largest angle alpha_0 from the predicted direction (eq. 22), in degrees.
    min_length
        Visible length from which on a needle is tracked, in m. Around an entry, tissue alone shows
        lines of 10 to 15 mm. See `least_length` for later volumes.
    max_gap
        Largest gap in the intensity along the needle that does not end it, in m.
    std
        Standard deviation of every coordinate of every control point, which gives the covariance R
        of eq. 7, in m.
    ransac
        Parameters of the random sample consensus. The refit of a straight needle is the published
        one. A bent one is optimized locally instead.
    end_contrast
        Level over the surroundings below which the needle ends, in dB.
    profile
        Sampling of the intensity along the axis: step and radii of the tubes.
    """

    candidate_volume: Positive = 400e-9
    margin: Positive = 20e-3
    max_angle_deg: Positive = 35.0
    min_length: Positive = 20e-3
    max_gap: Positive = 6e-3
    std: Positive = 1e-3
    end_contrast: Positive = 9.0
    ransac: RansacParameters = field(default_factory=_published_ransac)
    profile: TipParameters = field(default_factory=_published_profile)


def explain_published_localization(
    volume: Volume,
    prediction: NeedlePrediction | NotFound,
    parameters: PublishedLocalizationParameters,
    rng: np.random.Generator,
) -> LocalizationExplanation:
    """Localize the needle as in Chatelain 2013, section II-D, at once.

    A prediction without an entry is a detected insertion. Its curve runs from the candidate entry
    to the geometric median; direction and length of the needle are then unknown.
    """
    if isinstance(prediction, NotFound):
        return LocalizationExplanation(volume.time, prediction, (), prediction)
    assert prediction.curve is not None
    first = prediction.entry is None
    angle = np.pi / 2 if first else np.deg2rad(parameters.max_angle_deg)
    region = SearchRegion(prediction.curve, *4 * (parameters.margin,), float(angle))
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
    if length < least_length(first, parameters.min_length):
        return NotFound(f"only {1e3 * length:.1f} mm of the needle are visible")
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
    bright = profile.seen & (profile.level > surroundings + parameters.end_contrast)
    ends = intensity_drops(profile.a[bright], float(np.median(inliers)), parameters.max_gap)
    return np.array(ends)


def least_length(first: bool, min_length: float) -> float:
    """Return the length in m with which a volume must show a needle: half that of its start.

    Half, as a needle may be dim in places; less would throw the filter's entry forwards.
    """
    return min_length if first else min_length / 2


def intensity_drops(
    bright: NDArray[np.float64], middle: float, max_gap: float
) -> tuple[float, float]:
    """Return the ends of the bright stretch around ``middle``; no gap up to ``max_gap`` ends it."""
    start, tip = (_end(bright, middle, side, max_gap) for side in (-1, 1))
    return start, tip


def _end(bright: NDArray[np.float64], middle: float, side: int, max_gap: float) -> float:
    """Return the last abscissa to a side of the middle that no gap separates from it."""
    away = np.sort(side * (bright - middle))
    away = np.concatenate([[0.0], away[away > 0]])
    last = np.flatnonzero(np.append(np.diff(away), np.inf) > max_gap)[0]
    return middle + side * float(away[last])


def principal_axis(control_points: NDArray[np.float64]) -> Axis | NotFound:
    """Return the curve through (n, 3) control points over the line fitted to them (Chatelain 2013).

    Fig. 1 and eq. 18: k_0 is the direction of that line; abscissae count from the first point.
    """
    centred = control_points - control_points.mean(axis=0)
    k = np.linalg.svd(centred)[2][0]
    along = control_points[-1] - control_points[0]
    return axis_through(control_points, k if k @ along >= 0 else -k)


def relative_sagitta(control_points: NDArray[np.float64]) -> float:
    """Return the distance of the middle one of (3, 3) control points from the chord, over it."""
    first, middle, last = control_points
    chord = last - first
    length = float(np.linalg.norm(chord))
    if not length > 0:
        return np.inf
    aside = middle - first
    aside = aside - (aside @ chord) * chord / length**2
    return float(np.linalg.norm(aside)) / length


def optimize_locally(
    points: NDArray[np.float64], axis: Axis, *, max_bend: float, max_trials: int = 600
) -> Axis:
    """Optimize a bent axis on its (m, 3) inliers by Nelder and Mead's method (section II-D)."""
    a = axis.abscissa(points)
    start = axis.position(np.linspace(a.min(), a.max(), 3))

    def cost(variables: NDArray[np.float64]) -> float:
        control_points = variables.reshape(3, 3)
        if relative_sagitta(control_points) > max_bend:
            return np.inf
        curve = principal_axis(control_points)
        return np.inf if isinstance(curve, NotFound) else float(curve.distance(points).mean())

    simplex = start.ravel() + np.vstack([np.zeros(9), _FIRST_STEP * np.eye(9)])
    best = minimize(
        cost,
        start.ravel(),
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "maxfev": max_trials,
            "xatol": _TOLERANCE,
            "fatol": _TOLERANCE,
        },
    )
    optimized = principal_axis(best.x.reshape(3, 3))
    if isinstance(optimized, NotFound) or not best.fun <= axis.distance(points).mean():
        return axis
    return optimized
