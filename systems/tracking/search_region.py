"""Regions of a volume in which a needle is localized."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.localization_explanation import NeedleExtent, SearchRegion
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.tracking.axis import Axis
from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.tracking.tip import REACH

EVERYWHERE = 0.3
"""Length that exceeds any volume, in m."""

_LOST = 1.0
"""Logarithm of the odds that a needle lost a short while ago is still there, aside or not."""

_BRIGHT_SHARE, _LEAST_TURN = 0.7, 0.3
"""Share of the largest evidence above which a needle is bright, and share of the largest angle
that is left for the faintest."""

_LONG = 20e-3
"""Length in m above which the direction of a needle is known."""

_MOST_TURNED, _MOST_ASIDE, _MOST_ADVANCED, _MOST_LENGTHENED = math.radians(20), 25e-3, 50e-3, 1.0
"""Standard deviations of the changes since a needle was lost: direction in rad, distances of the
line from the last axis and between the tips in m, and logarithm of the visible length."""

_UNMOVED = 1 / 6
"""Share of those changes but the length's if neither tissue nor probe has moved, which is as
probable as that they have. Other lines lie anywhere. Chosen by ``python -m lost_needle_study``
(tests/tools)."""


def predicted_region(
    prediction: NeedlePrediction, parameters: NeedleLocalizerParameters
) -> SearchRegion:
    """Return the capsule around the predicted curve, sized by the prediction's covariance."""
    curve, P = prediction.curve, prediction.covariance
    assert curve is not None
    assert P is not None
    k = curve.direction
    project = np.eye(3) - np.outer(k, k)
    ends = [P[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in (0, curve.order - 1)]
    along = math.sqrt(float(k @ ends[-1] @ k))
    across = max(math.sqrt(np.linalg.eigvalsh(project @ end @ project)[-1]) for end in ends)
    margin = parameters.margin + prediction.missed * parameters.margin_growth
    region = SearchRegion(
        curve=curve,
        radius=min(margin + 3 * across, parameters.max_radius),
        before=margin,
        shaft_beyond=min(along, margin),
        # The tissue ahead is looked at before the needle comes there.
        beyond=min(3 * along + margin, 3 * parameters.max_radius) + REACH,
        max_angle=min(
            math.radians(parameters.max_angle_deg) + math.atan2(3 * across, max(curve.chord, 1e-3)),
            math.pi / 2,
        ),
        entry=prediction.entry,
        tissue=prediction.tissue,
    )
    if not parameters.volume_of_interest:
        far = EVERYWHERE
        region = replace(region, radius=far, before=far, beyond=far, shaft_beyond=far)
    if not parameters.angle_gate:
        region = replace(region, max_angle=math.pi / 2)
    return region


def found_again(
    log_odds: float, ends: NDArray[np.float64], last: NeedleCurve
) -> tuple[float, NDArray[np.float64]]:
    """Return the log odds that a line is the lost needle, and its ends in W, the entry first.

    There was a needle, so less evidence suffices. The tissue or the probe may have moved since, so
    the line may differ from the ``last`` curve, at the price of more evidence.
    """
    if (ends[1] - ends[0]) @ last.direction < 0:
        ends = ends[::-1]
    length = float(np.linalg.norm(ends[1] - ends[0]))
    angle = math.acos(min(float((ends[1] - ends[0]) @ last.direction) / length, 1.0))
    aside = ends.mean(axis=0) - last.tip
    aside -= (aside @ last.direction) * last.direction
    away = (
        (angle / _MOST_TURNED) ** 2
        + (float(np.linalg.norm(aside)) / _MOST_ASIDE) ** 2
        + (float(np.linalg.norm(ends[1] - last.tip)) / _MOST_ADVANCED) ** 2
    )
    lengthened = (math.log(length / max(last.chord, 1e-3)) / _MOST_LENGTHENED) ** 2
    # Two angles, two distances aside and one along the axis are near those of the last curve.
    unmoved = -away / _UNMOVED**2 / 2 - 5 * math.log(_UNMOVED)
    agreement = float(np.logaddexp(-away / 2, unmoved)) - lengthened / 2
    return log_odds + _LOST + agreement, ends


def line_region(line: NeedleCurve, parameters: NeedleLocalizerParameters) -> SearchRegion:
    """Return the capsule around a line in W that may be a new needle."""
    return SearchRegion(
        curve=line,
        radius=0.8 * parameters.margin,
        before=parameters.search_reach,
        beyond=parameters.search_reach,
        shaft_beyond=0.0,
        max_angle=math.radians(parameters.max_angle_deg),
    )


def narrow_region(region: SearchRegion, parameters: NeedleLocalizerParameters) -> SearchRegion:
    """Return the part of a region in which a faint needle must lie if it moved as predicted.

    Where much else is bright, the needle fills too little of a large region.
    """
    return replace(
        region,
        radius=min(region.radius, 0.8 * parameters.margin),
        max_angle=min(region.max_angle, math.radians(parameters.max_angle_deg) / 2),
    )


def turns_too_far(
    region: SearchRegion, axis: Axis, extent: NeedleExtent, parameters: NeedleLocalizerParameters
) -> bool:
    """Return True if a followed needle seems to turn, and too little of it is visible to show that.

    Where it fades, other bright structures draw its axis away, volume by volume. The less evidence
    there is of what a bright needle gives, the nearer its direction must be to the prediction.
    """
    if not parameters.angle_gate or region.entry is None or region.curve.chord < _LONG:
        return False
    most = parameters.tip.max_evidence * max(region.curve.chord, parameters.min_length)
    share = min(extent.evidence / most / _BRIGHT_SHARE, 1.0)
    largest = math.radians(parameters.max_angle_deg) * max(share, _LEAST_TURN)
    turn = float(np.clip(axis.direction @ region.curve.direction, -1, 1))
    return math.acos(turn) > largest
