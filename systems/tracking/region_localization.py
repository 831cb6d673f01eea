"""Localization in one region of a volume: candidates, consensus, extent, refit and decision."""

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import (
    AxisProfile,
    LocalizationAttempt,
    NeedleExtent,
    SearchRegion,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.tissue_record import TissueRecord
from sonoservo.systems.signals.volume import Volume, acquired_from
from sonoservo.systems.tracking.axis import axis_through
from sonoservo.systems.tracking.axis_fit import AxisFit, fit_axis
from sonoservo.systems.tracking.candidates import select_candidates
from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.tracking.ransac import RansacResult, ransac_axis
from sonoservo.systems.tracking.search_region import (
    EVERYWHERE,
    turns_too_far,
)
from sonoservo.systems.tracking.tip import axis_profile, find_extent

T = TypeVar("T")


_SOUND_SPEED = 0.02
"""Relative standard deviation of the speed of sound: in fat it is 1450 m/s, in muscle 1580."""


class _AbsentError(Exception):
    """Ends an attempt without a needle, for the reason given."""


def _expect(value: T | NotFound) -> T:
    """Return a value that the attempt needs; raise its reason if there is none."""
    if isinstance(value, NotFound):
        raise _AbsentError(value.reason)
    return value


def localize_in_region(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    rng: np.random.Generator,
    times: int = 1,
) -> list[LocalizationAttempt]:
    """Localize the needle in a region of a volume, once or more; ``rng`` draws the samples."""
    try:
        points, weights = _candidates(volume, region, parameters)
    except _AbsentError as absent:
        return times * [LocalizationAttempt(region, NotFound(absent.args[0]))]
    found = [
        ransac_axis(
            points,
            weights,
            order=region.curve.order,
            rng=rng,
            parameters=parameters.ransac,
            direction=region.curve.direction,
            max_angle=region.max_angle,
        )
        for _ in range(times)
    ]
    attempts: list[LocalizationAttempt] = []
    for each in found:
        # Many samples lead to the same axis, along which nothing else would be found.
        again = [
            tried for other, tried in zip(found, attempts, strict=False) if _same_axis(each, other)
        ]
        looked: dict[str, Any] = {"candidates": points, "weights": weights}
        attempts += again[:1] or [_attempt(volume, region, parameters, each, looked)]
    return attempts


def _same_axis(a: RansacResult | NotFound, b: RansacResult | NotFound) -> bool:
    if isinstance(a, NotFound) or isinstance(b, NotFound):
        return False
    return np.array_equal(a.fit.axis.coefficients, b.fit.axis.coefficients)


def _attempt(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    consensus: RansacResult | NotFound,
    looked: dict[str, Any],
) -> LocalizationAttempt:
    """Return the attempt that goes on from a consensus, with what was ``looked`` at so far."""
    try:
        result: NeedleMeasurement | NotFound = _measure(
            volume, region, parameters, _expect(consensus), looked
        )
    except _AbsentError as absent:
        result = NotFound(absent.args[0])
    return LocalizationAttempt(region, result, **looked)


def _measure(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    consensus: RansacResult,
    looked: dict[str, Any],
) -> NeedleMeasurement:
    """Measure the needle near a consensus, and store the intermediate results in ``looked``."""
    points, weights, rough = looked["candidates"], looked["weights"], consensus.fit
    looked.update(inliers=consensus.inliers)
    extent = _extent(volume, region, parameters, rough, looked)
    fit = _refit(points, weights, parameters, rough, extent)
    extent = _extent(volume, region, parameters, fit, looked)
    if turns_too_far(region, fit.axis, extent, parameters):
        raise _AbsentError(SearchReason.HARDLY_SEEN(" a part is seen of what turned"))
    inliers, between = _inliers(points, parameters, fit, extent)
    measured = _judge(
        volume, region, parameters, fit, extent, int(inliers.sum()), int(between.sum())
    )
    known = region.entry if region.entry is not None else measured.curve.entry
    distance = looked["profile"].a - float(fit.axis.abscissa(known))
    tissue = (region.tissue or TissueRecord.unseen(parameters.tip.step)).seen(
        distance, extent.contrast, extent.ahead, extent.as_before
    )
    return replace(measured, tissue=tissue)


def _candidates(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (m, 3) candidate voxels in W, in m, and their (m,) weights."""
    candidates = select_candidates(
        volume,
        _expect(axis_through(acquired_from(volume, region.curve.control_points))),
        start=-region.before,
        # The shaft determines the axis. Voxels beyond the predicted tip may be something else.
        stop=region.curve.chord + region.shaft_beyond,
        radius=region.radius,
        cross_section=parameters.cross_section,
        slab=parameters.slab,
    )
    if len(candidates.p_P) == 0:
        raise _AbsentError(SearchReason.OUT_OF_VIEW(" the field of view"))
    return volume.to_world(candidates.p_P)[0], candidates.weights


def _extent(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    fit: AxisFit,
    looked: dict[str, Any],
) -> NeedleExtent:
    """Find the points at which the needle begins and ends along an axis."""
    ends = np.sort(fit.axis.abscissa(region.curve.control_points[[0, -1]]))
    # A needle that was thrown forwards goes on beyond the region.
    for beyond in (region.beyond, EVERYWHERE):
        start, stop = ends[0] - region.before, ends[1] + beyond
        profile: AxisProfile = axis_profile(volume, fit.axis, start, stop, parameters.tip)
        if region.entry is not None and region.tissue is not None:
            distance = profile.a - float(fit.axis.abscissa(region.entry))
            before, looks = region.tissue.at(distance)
            profile = replace(profile, before=before, looks=looks)
        looked.update(profile=profile, extent=None)
        extent = _expect(find_extent(profile, parameters.tip))
        looked.update(extent=extent)
        if region.entry is None or not (extent.leaves and profile.seen[-1]):
            break
    if extent.end - extent.start < parameters.min_length:
        visible = 1e3 * max(extent.end - extent.start, 0.0)
        raise _AbsentError(SearchReason.HARDLY_SEEN(f" {visible:.1f} mm of the needle are visible"))
    return extent


def _inliers(
    points: NDArray[np.float64],
    parameters: NeedleLocalizerParameters,
    fit: AxisFit,
    extent: NeedleExtent,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return flags of the candidates between the ends near the axis, and of all between them."""
    a = fit.axis.abscissa(points)
    between = np.asarray((a >= extent.start) & (a <= extent.tip))
    return between & (fit.axis.distance(points) < parameters.ransac.residual_threshold), between


def _refit(
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    parameters: NeedleLocalizerParameters,
    fit: AxisFit,
    extent: NeedleExtent,
) -> AxisFit:
    """Fit the axis to the inliers between the needle's ends."""
    if parameters.ransac.refits == 0:
        return fit
    inliers, _ = _inliers(points, parameters, fit, extent)
    axis = fit.axis
    return _expect(fit_axis(points[inliers], weights[inliers], axis.order, axis.direction))


def _judge(
    volume: Volume,
    region: SearchRegion,
    parameters: NeedleLocalizerParameters,
    fit: AxisFit,
    extent: NeedleExtent,
    inliers: int,
    candidates: int,
) -> NeedleMeasurement:
    """Return the control points and their covariance, if the evidence is sufficient."""
    ratio = float(inliers / max(candidates, 1))
    if extent.evidence < parameters.min_evidence:
        raise _AbsentError(SearchReason.NOTHING_ALONG(" the axis stands out enough"))
    start = extent.start
    if region.entry is not None:
        known = float(fit.axis.abscissa(region.entry))
        # A probe that follows a needle on its way out sees more of it than its known entry.
        outside = extent.tip - known < parameters.min_length and known - start > region.before / 2
        start = start if outside else known
    if extent.tip - start < parameters.min_length:
        raise _AbsentError(SearchReason.WITHDRAWN(" to its entry"))
    # Interior points are uniform along the chord. The entry rests, the tip moves, no point slides.
    order = region.curve.order
    u = np.linspace(0, 1, order)
    a = start + u * (extent.tip + extent.bevel - start)
    k = fit.axis.direction
    deeper = volume.X_WP.rotation().matrix()[:, 1]
    deeper = deeper - (deeper @ k) * k
    curve = NeedleCurve(fit.axis.position(a) + parameters.echo_offset * deeper)
    independent = max((extent.end - extent.start) / parameters.correlation_length, order + 1.0)
    tip_std = float(np.hypot(parameters.tip_std, extent.tip_std))
    ends = np.stack([1 - u, u], axis=1)
    along = ends @ np.diag([parameters.entry_std**2, tip_std**2]) @ ends.T
    covariance = (
        fit.covariance(a, independent)
        + np.kron(along, np.outer(k, k))
        + parameters.echo_offset_std**2 * np.tile(np.outer(deeper, deeper), (order, order))
        + parameters.systematic_std**2 * np.eye(3 * len(u))
    )
    # Sound is faster or slower than the scanner assumes, so all depths are off by the same factor.
    depths = acquired_from(volume, curve.control_points)[:, 1]
    stretched = _SOUND_SPEED * np.outer(depths, volume.X_WP.rotation().matrix()[:, 1]).ravel()
    common = np.outer(stretched, stretched)
    common[-3:, -3:] += extent.bevel_std**2 * np.outer(k, k)
    time = float(volume.to_world(acquired_from(volume, curve.control_points[-1:]))[1][0])
    return NeedleMeasurement(
        curve,
        covariance,
        time,
        inliers,
        ratio,
        volume.X_WP,
        tip_seen=min(extent.seen, 1.0),
        elsewhere=extent.elsewhere,
        common=common,
        unseen=extent.unseen,
    )
