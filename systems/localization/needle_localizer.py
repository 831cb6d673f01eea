"""Localizes the needle in one volume, given a prediction."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.estimation.estimate import TrackingMode
from sonoservo.systems.estimation.track import NeedleTrack
from sonoservo.systems.localization.axis import axis_through
from sonoservo.systems.localization.axis_fit import AxisFit, fit_axis
from sonoservo.systems.localization.candidates import acquired_from, select_candidates
from sonoservo.systems.localization.line_search import bright_lines
from sonoservo.systems.localization.measurement import NeedleMeasurement
from sonoservo.systems.localization.ransac import RansacParameters, ransac_axis
from sonoservo.systems.localization.tip import (
    NeedleExtent,
    TipParameters,
    axis_profile,
    find_extent,
)
from sonoservo.systems.localization.whole_volume import find_needle_line
from sonoservo.systems.needle.curve import NeedleCurve
from sonoservo.systems.ultrasound.volume import Volume
from sonoservo.systems.values import NotFound, evaluate, require, require_positive


@dataclass(kw_only=True)
class NeedleLocalizerParameters:
    """Where the needle is sought, and what counts as found. The paper publishes no values.

    Parameters
    ----------
    order
        n of the curve: 2 straight, 3 bent.
    margin
        Around the predicted curve, beyond three standard deviations, in m.
    margin_growth
        Further margin for every volume that did not confirm the needle, in m.
    largest_radius
        Of the volume of interest, in m.
    largest_angle_deg
        alpha_0 about a certain prediction, in degrees; the prediction's uncertainty is added.
    cross_section
        Area of the candidates across the needle, in m^2.
    slab
        Length of needle that shares a threshold, in m.
    least_length, least_share
        That must be visible, in m, and of the predicted length that lies in the field of view.
    largest_aside
        Of what moved from the axis of a needle newly found, in m.
    largest_entry_gap
        From where a needle newly found enters the field of view to where it stands out, in m: it
        comes from outside, inclusions do not.
    search_reach
        Beyond either end of a bright line, for a needle that was lost, in m.
    least_inlier_ratio
        Of the candidates between entry and tip.
    least_evidence
        How much must stand out from the background along the needle, in dB m; see `NeedleExtent`.
    correlation_length
        Length of needle that one beam width blurs into one observation, in m.
    tip_deviation, entry_deviation
        Standard deviations along the axis, in m. A volume does not tell where along the axis the
        entry is; it rests, so it is measured where it was last, not where it is predicted: a
        velocity along the axis would never be contradicted otherwise.
    unseen_tip_deviation
        The same where the needle leaves the field of view.
    echo_offset
        From the centre of the needle's echo to its axis, away from the probe, in m: the sound
        returns from the front wall, but for what goes to and fro inside.
    systematic_deviation
        Of every control point in every direction, in m.
    volume_of_interest
        Whether only the surroundings of the prediction are searched; off, all of the volume is.
    angle_gate
        Whether an axis must agree with the predicted direction (eq. 22).
    sweep_time
        Whether each frame counts as acquired at its own time, from where the probe then was; off,
        all of the volume counts as acquired at its middle.
    """

    order: int = 2
    margin: float = 3e-3
    margin_growth: float = 2e-3
    largest_radius: float = 20e-3
    largest_angle_deg: float = 10.0
    cross_section: float = 4e-6
    slab: float = 2e-3
    least_length: float = 4e-3
    least_share: float = 0.4
    largest_aside: float = 2.5e-3
    largest_entry_gap: float = 8e-3
    search_reach: float = 40e-3
    least_inlier_ratio: float = 0.15
    least_evidence: float = 12e-3
    correlation_length: float = 2e-3
    tip_deviation: float = 0.6e-3
    entry_deviation: float = 1e-3
    unseen_tip_deviation: float = 10e-3
    echo_offset: float = 0.4e-3
    systematic_deviation: float = 0.1e-3
    volume_of_interest: bool = True
    angle_gate: bool = True
    sweep_time: bool = True
    ransac: RansacParameters = field(default_factory=RansacParameters)
    tip: TipParameters = field(default_factory=TipParameters)

    def __post_init__(self) -> None:
        require(self.order in (2, 3), "order", self.order, "2 or 3")
        require_positive(
            margin=self.margin,
            margin_growth=self.margin_growth,
            largest_radius=self.largest_radius,
            largest_angle_deg=self.largest_angle_deg,
            cross_section=self.cross_section,
            slab=self.slab,
            least_length=self.least_length,
            least_share=self.least_share,
            largest_aside=self.largest_aside,
            largest_entry_gap=self.largest_entry_gap,
            search_reach=self.search_reach,
            least_inlier_ratio=self.least_inlier_ratio,
            least_evidence=self.least_evidence,
            correlation_length=self.correlation_length,
            tip_deviation=self.tip_deviation,
            entry_deviation=self.entry_deviation,
            unseen_tip_deviation=self.unseen_tip_deviation,
            systematic_deviation=self.systematic_deviation,
        )


_REPEATS = 7
"""Of the search along a line of which nothing else is known; the middlemost result counts."""

_EVERYWHERE = 0.3
"""More than any volume measures, in m."""


@dataclass(frozen=True, eq=False)
class _Region:
    """Where to look: around a curve in W; its entry if known, and whether its tip moved.

    ``followed`` counts how often a needle newly found was followed towards the outside.
    """

    curve: NeedleCurve
    radius: float
    before: float
    beyond: float
    shaft_beyond: float
    largest_angle: float
    entry: NDArray[np.float64] | None = None
    tip_moved: bool = False
    followed: int = 0


def _predicted_region(
    track: NeedleTrack, time: float, parameters: NeedleLocalizerParameters
) -> _Region:
    """Capsule around the predicted curve, from the prediction's covariance."""
    searching = track.mode == TrackingMode.SEARCHING
    entry = track.curve.entry
    track = track.predicted(time)
    assert track.covariance is not None
    curve, n, k = track.curve, track.order, track.curve.direction
    project = np.eye(3) - np.outer(k, k)
    ends = [track.covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in (0, n - 1)]
    along = math.sqrt(float(k @ ends[-1] @ k))
    across = max(math.sqrt(np.linalg.eigvalsh(project @ end @ project)[-1]) for end in ends)
    margin = parameters.margin + track.missed * parameters.margin_growth
    region = _Region(
        curve=curve,
        radius=min(margin + 3 * across, parameters.largest_radius),
        before=parameters.largest_entry_gap if searching else margin,
        shaft_beyond=along,
        # Of what has just been detected, the tip is known best.
        beyond=min(3 * along + (0 if searching else margin), 3 * parameters.largest_radius),
        largest_angle=min(
            math.radians(parameters.largest_angle_deg)
            + math.atan2(3 * across, max(curve.chord, 1e-3)),
            math.pi / 4 if searching else math.pi / 2,
        ),
        # Of what has just been detected, the entry is a guess.
        entry=None if searching else entry,
        tip_moved=searching,
    )
    if not parameters.volume_of_interest:
        far = _EVERYWHERE
        region = replace(region, radius=far, before=far, beyond=far, shaft_beyond=far)
    if not parameters.angle_gate:
        region = replace(region, largest_angle=math.pi / 2)
    return region


def _localize_in(
    volume: Volume,
    region: _Region,
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
        largest_angle=region.largest_angle,
    )
    if isinstance(found, NotFound):
        return found
    return _measure(volume, region, parameters, points, candidates.weights, found.fit, rng)


def _measure(
    volume: Volume,
    region: _Region,
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
        if away > parameters.largest_entry_gap or aside > parameters.largest_aside:
            return NotFound("what was found is not what moved")
    inliers = _between(points, fit, extent) & (
        fit.axis.distance(points) < parameters.ransac.inlier_distance
    )
    if parameters.ransac.refits > 0:
        refit = fit_axis(points[inliers], weights[inliers], parameters.order, fit.axis.direction)
        if isinstance(refit, NotFound):
            return refit
        fit = refit
    extent = _extent(volume, region, parameters, fit)
    if isinstance(extent, NotFound):
        return extent
    if region.entry is None and extent.start - extent.entered > parameters.largest_entry_gap:
        longer = _towards_outside(region, parameters, fit, extent)
        if isinstance(longer, NotFound):
            return longer
        return _localize_in(volume, longer, parameters, rng)
    candidates = _between(points, fit, extent)
    inliers = candidates & (fit.axis.distance(points) < parameters.ransac.inlier_distance)
    return _judge(volume, region, parameters, fit, extent, inliers.sum(), candidates.sum())


def _towards_outside(
    region: _Region, parameters: NeedleLocalizerParameters, fit: AxisFit, extent: NeedleExtent
) -> _Region | NotFound:
    """Return where to look for the rest of a needle of which only the end was found.

    Where a needle moved fast, only the part that is new stood out at first. It is followed as long
    as it proves longer.
    """
    before = fit.axis.abscissa(region.curve.entry) - extent.start
    if region.followed > 0 and before < parameters.least_length:
        return NotFound("what was found does not come from outside the field of view")
    ends = np.linspace(extent.start, extent.tip, parameters.order)
    return _Region(
        curve=NeedleCurve(fit.axis.position(ends)),
        radius=2 * parameters.margin,
        before=parameters.search_reach,
        beyond=parameters.margin,
        shaft_beyond=0.0,
        largest_angle=math.radians(2 * parameters.largest_angle_deg),
        followed=region.followed + 1,
    )


def _extent(
    volume: Volume, region: _Region, parameters: NeedleLocalizerParameters, fit: AxisFit
) -> NeedleExtent | NotFound:
    """Find where the needle begins and ends along an axis."""
    ends = np.sort(fit.axis.abscissa(region.curve.control_points[[0, -1]]))
    profile = axis_profile(
        volume, fit.axis, ends[0] - region.before, ends[1] + region.beyond, parameters.tip
    )
    extent = find_extent(profile, parameters.tip)
    least = parameters.least_length
    if region.entry is not None:
        predicted = profile.seen & (profile.a >= ends[0]) & (profile.a <= ends[1])
        least = max(least, parameters.least_share * parameters.tip.step * float(predicted.sum()))
    if isinstance(extent, NeedleExtent) and extent.tip - extent.start < least:
        return NotFound(f"only {1e3 * (extent.tip - extent.start):.1f} mm of it are visible")
    return extent


def _between(points: NDArray[np.float64], fit: AxisFit, extent: NeedleExtent) -> NDArray[np.bool_]:
    a = fit.axis.abscissa(points)
    return np.asarray((a >= extent.start) & (a <= extent.tip))


def _judge(
    volume: Volume,
    region: _Region,
    parameters: NeedleLocalizerParameters,
    fit: AxisFit,
    extent: NeedleExtent,
    inliers: int,
    candidates: int,
) -> NeedleMeasurement | NotFound:
    """Measure the control points and their covariance, unless there is too little to believe."""
    ratio = float(inliers / max(candidates, 1))
    if ratio < parameters.least_inlier_ratio:
        return NotFound(f"only {100 * ratio:.0f} % of the candidates lie on the axis")
    if extent.evidence < parameters.least_evidence:
        return NotFound("too little stands out from the background along the axis")
    start = extent.start if region.entry is None else float(fit.axis.abscissa(region.entry))
    if extent.tip - start < parameters.least_length:
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
    tip_deviation = parameters.unseen_tip_deviation if extent.leaves else parameters.tip_deviation
    ends = np.stack([1 - u, u], axis=1)
    along = ends @ np.diag([parameters.entry_deviation**2, tip_deviation**2]) @ ends.T
    covariance = (
        fit.covariance(a, independent)
        + np.kron(along, np.outer(k, k))
        + parameters.systematic_deviation**2 * np.eye(3 * len(u))
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
        region = _predicted_region(track, volume.time, parameters)
        return _localize_in(volume, region, parameters, rng)
    best: NeedleMeasurement | None = None
    for line in bright_lines(volume, rng):
        ends = volume.to_world(line)[0]
        if (ends[1] - ends[0]) @ track.curve.direction < 0:
            ends = ends[::-1]
        found = _localize_in(
            volume,
            _Region(
                curve=NeedleCurve(np.linspace(ends[0], ends[1], parameters.order)),
                radius=2 * parameters.margin,
                before=parameters.search_reach,
                beyond=parameters.search_reach,
                shaft_beyond=parameters.search_reach,
                largest_angle=math.radians(2 * parameters.largest_angle_deg),
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
    line = find_needle_line(volume, rng, decibels_per_level=parameters.tip.decibels_per_level)
    if isinstance(line, NotFound):
        return line, 0.0
    entry, tip = volume.to_world(line.ends)[0]
    region = _Region(
        curve=NeedleCurve(np.linspace(entry, tip, parameters.order)),
        radius=0.8 * parameters.margin,
        before=parameters.largest_entry_gap,
        beyond=2 * parameters.margin,
        shaft_beyond=0.0,
        largest_angle=math.radians(parameters.largest_angle_deg),
    )
    # Of a short needle, thick as the beam shows it, draws tell the axis differently.
    found = [_localize_in(volume, region, parameters, rng) for _ in range(_REPEATS)]
    measured = [each for each in found if isinstance(each, NeedleMeasurement)]
    if 2 * len(measured) <= len(found):
        return next(each for each in found if isinstance(each, NotFound)), 0.0
    points = np.array([each.curve.control_points for each in measured])
    away = np.linalg.norm(points - np.median(points, axis=0), axis=-1).sum(axis=-1)
    return measured[int(away.argmin())], line.evidence


class NeedleLocalizer(LeafSystem):
    """Localizes the needle in one volume.

    .. pydrake_system::

        name: NeedleLocalizer
        input_ports:
        - volume
        - prediction
        output_ports:
        - measurement

    Stateless. Candidate voxels are the brightest ones around the predicted curve (Chatelain 2013,
    eq. 15); a random sample consensus fits the axis (eqs. 16-22); the tip is where the intensity
    along it drops. ``prediction`` is a `NeedleTrack`, ``measurement`` a `NeedleMeasurement` in W or
    a `NotFound` that says why there is none.

    Parameters
    ----------
    parameters
        Thresholds, in SI units.
    seed
        Of the random samples.
    """

    def __init__(
        self, *, parameters: NeedleLocalizerParameters | None = None, seed: int = 0
    ) -> None:
        super().__init__()
        self._parameters = parameters or NeedleLocalizerParameters()
        self._seed = seed
        self.DeclareAbstractInputPort("volume", Value[object]())
        self.DeclareAbstractInputPort("prediction", Value[object]())
        self.DeclareAbstractOutputPort(
            "measurement", lambda: Value[object](), self._calc_measurement
        )

    def _calc_measurement(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        track = evaluate(self, context, "prediction", NeedleTrack)
        if not isinstance(volume, Volume):
            output.set_value(volume)
            return
        # Keyed by the volume's time, so that a stateless system repeats itself.
        rng = np.random.default_rng([self._seed, int(abs(volume.time) * 1e9)])
        output.set_value(localize(volume, track, self._parameters, rng))
