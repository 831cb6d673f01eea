"""Finds the needle in one volume."""

import math

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.track import NeedleTrack
from sonoservo.systems.localization.axis import axis_through
from sonoservo.systems.localization.axis_fit import AxisFit, fit_axis
from sonoservo.systems.localization.candidates import acquired_from, select_candidates
from sonoservo.systems.localization.line_search import bright_lines
from sonoservo.systems.localization.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.localization.ransac import ransac_axis
from sonoservo.systems.localization.search_region import (
    SearchRegion,
    predicted_region,
    towards_outside,
)
from sonoservo.systems.localization.tip import NeedleExtent, axis_profile, find_extent
from sonoservo.systems.localization.whole_volume import find_needle_line
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.volume import Volume

_REPEATS = 7
"""Of the search along a line of which nothing else is known; the middlemost result counts."""


def _localize_in(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
) -> NeedleMeasurement | NotFound:
    axis = axis_through(acquired_from(volume, region.curve.control_points))
    if isinstance(axis, NotFound):
        return axis
    candidates = select_candidates(
        volume,
        axis,
        start=-region.before,
        # The shaft tells the axis; what lies beyond the predicted tip may be something else.
        stop=region.curve.chord + region.shaft_beyond,
        radius=region.radius,
        cross_section=parameters.cross_section,
        slab=parameters.slab,
        rng=rng,
    )
    if len(candidates.p_P) == 0:
        return NotFound("the predicted needle lies outside the field of view")
    points = volume.to_world(candidates.p_P)[0]
    found = ransac_axis(
        points,
        candidates.weights,
        order=parameters.order,
        rng=rng,
        parameters=parameters.ransac,
        direction=region.curve.direction,
        max_angle=region.max_angle,
    )
    if isinstance(found, NotFound):
        return found
    return _measure(volume, region, parameters, points, candidates.weights, found.fit, rng)


def _measure(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    fit: AxisFit,
    rng: np.random.Generator,
) -> NeedleMeasurement | NotFound:
    """Find the needle's ends along the axis, refit between them, and judge."""
    extent = _extent(volume, region, parameters, fit)
    if isinstance(extent, NotFound):
        return extent
    if region.tip_moved:
        # Of a needle just detected it is the tip that moved.
        ends = fit.axis.position([extent.start, extent.tip])
        away = np.linalg.norm(ends - region.curve.tip, axis=1).min()
        aside = fit.axis.distance(region.curve.tip)
        if away > parameters.max_entry_gap or aside > parameters.max_aside:
            return NotFound("what was found is not what moved")
    inliers = _between(points, fit, extent) & (
        fit.axis.distance(points) < parameters.ransac.residual_threshold
    )
    if parameters.ransac.refits > 0:
        refit = fit_axis(points[inliers], weights[inliers], parameters.order, fit.axis.direction)
        if isinstance(refit, NotFound):
            return refit
        fit = refit
    extent = _extent(volume, region, parameters, fit)
    if isinstance(extent, NotFound):
        return extent
    if region.entry is None and extent.start - extent.entered > parameters.max_entry_gap:
        longer = towards_outside(region, parameters, fit, extent)
        if isinstance(longer, NotFound):
            return longer
        return _localize_in(volume, longer, parameters, rng)
    candidates = _between(points, fit, extent)
    inliers = candidates & (fit.axis.distance(points) < parameters.ransac.residual_threshold)
    return _judge(volume, region, parameters, fit, extent, inliers.sum(), candidates.sum())


def _extent(
    volume: Volume, region: SearchRegion, parameters: NeedleLocalizerParameters, fit: AxisFit
) -> NeedleExtent | NotFound:
    """Find where the needle begins and ends along an axis."""
    ends = np.sort(fit.axis.abscissa(region.curve.control_points[[0, -1]]))
    profile = axis_profile(
        volume, fit.axis, ends[0] - region.before, ends[1] + region.beyond, parameters.tip
    )
    extent = find_extent(profile, parameters.tip)
    least = parameters.min_length
    if region.entry is not None:
        predicted = profile.seen & (profile.a >= ends[0]) & (profile.a <= ends[1])
        least = max(least, parameters.min_share * parameters.tip.step * float(predicted.sum()))
    if isinstance(extent, NeedleExtent) and extent.tip - extent.start < least:
        return NotFound(f"only {1e3 * (extent.tip - extent.start):.1f} mm of it are visible")
    return extent


def _between(points: NDArray[np.float64], fit: AxisFit, extent: NeedleExtent) -> NDArray[np.bool_]:
    a = fit.axis.abscissa(points)
    return np.asarray((a >= extent.start) & (a <= extent.tip))


def _judge(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    fit: AxisFit,
    extent: NeedleExtent,
    inliers: int,
    candidates: int,
) -> NeedleMeasurement | NotFound:
    """Measure the control points and their covariance, unless there is too little to believe."""
    ratio = float(inliers / max(candidates, 1))
    if ratio < parameters.min_inlier_ratio:
        return NotFound(f"only {100 * ratio:.0f} % of the candidates lie on the axis")
    if extent.evidence < parameters.min_evidence:
        return NotFound("too little stands out from the background along the axis")
    start = extent.start if region.entry is None else float(fit.axis.abscissa(region.entry))
    if extent.tip - start < parameters.min_length:
        return NotFound("the needle has been withdrawn to its entry")
    # Interior points uniform in chord: the entry rests, the tip moves, no point slides.
    u = np.linspace(0, 1, parameters.order)
    a = start + u * (extent.tip - start)
    k = fit.axis.direction
    deeper = volume.X_WP.rotation().matrix()[:, 1]
    offset = parameters.echo_offset * (deeper - (deeper @ k) * k)
    curve = NeedleCurve(fit.axis.position(a) + offset)
    independent = max(
        (extent.tip - extent.start) / parameters.correlation_length, parameters.order + 1.0
    )
    tip_std = parameters.unseen_tip_std if extent.leaves else parameters.tip_std
    ends = np.stack([1 - u, u], axis=1)
    along = ends @ np.diag([parameters.entry_std**2, tip_std**2]) @ ends.T
    covariance = (
        fit.covariance(a, independent)
        + np.kron(along, np.outer(k, k))
        + parameters.systematic_std**2 * np.eye(3 * len(u))
    )
    time = float(volume.to_world(acquired_from(volume, curve.control_points[-1:]))[1][0])
    return NeedleMeasurement(curve, covariance, time, int(inliers), ratio)


def localize(
    volume: Volume,
    track: NeedleTrack,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
) -> NeedleMeasurement | NotFound:
    """Find the needle in a volume (Chatelain 2013, section II-D).

    Parameters
    ----------
    volume
        To search.
    track
        What is known so far; it is predicted to the volume's time. A lost needle is sought in the
        whole volume.
    parameters
        Thresholds.
    rng
        Draws samples.

    Returns
    -------
    The measurement in W, or a `NotFound` that says why there is none.
    """
    if not track and track.mode != TrackingMode.LOST:
        return NotFound("no needle has been detected")
    track = track.seen_from(volume.X_WP)
    if not parameters.sweep_time:
        volume = volume.at_once()
    if not track:
        return seek_needle(volume, parameters, rng)[0]
    if track.mode != TrackingMode.LOST:
        region = predicted_region(track, volume.time, parameters)
        return _localize_in(volume, region, parameters, rng)
    best: NeedleMeasurement | None = None
    for line in bright_lines(volume, rng):
        ends = volume.to_world(line)[0]
        if (ends[1] - ends[0]) @ track.curve.direction < 0:
            ends = ends[::-1]
        found = _localize_in(
            volume,
            SearchRegion(
                curve=NeedleCurve(np.linspace(ends[0], ends[1], parameters.order)),
                radius=2 * parameters.margin,
                before=parameters.search_reach,
                beyond=parameters.search_reach,
                shaft_beyond=parameters.search_reach,
                max_angle=math.radians(2 * parameters.max_angle_deg),
            ),
            parameters,
            rng,
        )
        if isinstance(found, NeedleMeasurement):
            best = found if best is None or found.curve.chord > best.curve.chord else best
    return best or NotFound("no needle in the whole volume")


def seek_needle(
    volume: Volume, parameters: NeedleLocalizerParameters, rng: np.random.Generator
) -> tuple[NeedleMeasurement | NotFound, float]:
    """Find the needle in a volume of which nothing else is known.

    Parameters
    ----------
    volume
        To search.
    parameters
        Thresholds.
    rng
        Draws samples.

    Returns
    -------
    The measurement in W, or a `NotFound` that says why there is none, and the evidence for it in
    dB m (`NeedleLine`).
    """
    line = find_needle_line(volume, rng)
    if isinstance(line, NotFound):
        return line, 0.0
    entry, tip = volume.to_world(line.ends)[0]
    region = SearchRegion(
        curve=NeedleCurve(np.linspace(entry, tip, parameters.order)),
        radius=0.8 * parameters.margin,
        before=parameters.max_entry_gap,
        beyond=2 * parameters.margin,
        shaft_beyond=0.0,
        max_angle=math.radians(parameters.max_angle_deg),
    )
    # Of a short needle, thick as the beam shows it, draws tell the axis differently.
    found = [_localize_in(volume, region, parameters, rng) for _ in range(_REPEATS)]
    measured = [each for each in found if isinstance(each, NeedleMeasurement)]
    if 2 * len(measured) <= len(found):
        return next(each for each in found if isinstance(each, NotFound)), 0.0
    points = np.array([each.curve.control_points for each in measured])
    away = np.linalg.norm(points - np.median(points, axis=0), axis=-1).sum(axis=-1)
    return measured[int(away.argmin())], line.evidence
