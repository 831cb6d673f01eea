"""Where in a volume a needle is sought."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.track import NeedleTrack
from sonoservo.systems.localization.axis_fit import AxisFit
from sonoservo.systems.localization.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.localization.tip import NeedleExtent
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode

_EVERYWHERE = 0.3
"""More than any volume measures, in m."""


@dataclass(frozen=True, eq=False)
class SearchRegion:
    """Where in a volume a needle is sought.

    Parameters
    ----------
    curve
        Around which to look, in W.
    radius
        Of the capsule around it, in m.
    before, beyond
        How far the profile along the needle goes on past the curve's ends, in m.
    shaft_beyond
        How far past the curve's tip voxels still count as candidates for the shaft, in m.
    max_angle
        Between the needle and the curve, in rad.
    entry
        (3,) where the needle enters, in W; None where that is to be found.
    tip_moved
        Whether all that is known is that the curve's tip moved.
    followed
        How often a needle newly found was followed towards the outside.
    """

    curve: NeedleCurve
    radius: float
    before: float
    beyond: float
    shaft_beyond: float
    max_angle: float
    entry: NDArray[np.float64] | None = None
    tip_moved: bool = False
    followed: int = 0


def predicted_region(
    track: NeedleTrack, time: float, parameters: NeedleLocalizerParameters
) -> SearchRegion:
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
    region = SearchRegion(
        curve=curve,
        radius=min(margin + 3 * across, parameters.max_radius),
        before=parameters.max_entry_gap if searching else margin,
        shaft_beyond=along,
        # Of what has just been detected, the tip is known best.
        beyond=min(3 * along + (0 if searching else margin), 3 * parameters.max_radius),
        max_angle=min(
            math.radians(parameters.max_angle_deg) + math.atan2(3 * across, max(curve.chord, 1e-3)),
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
        region = replace(region, max_angle=math.pi / 2)
    return region


def towards_outside(
    region: SearchRegion, parameters: NeedleLocalizerParameters, fit: AxisFit, extent: NeedleExtent
) -> SearchRegion | NotFound:
    """Return where to look for the rest of a needle of which only the end was found.

    Where a needle moved fast, only the part that is new stood out at first. It is followed as long
    as it proves longer.
    """
    before = fit.axis.abscissa(region.curve.entry) - extent.start
    if region.followed > 0 and before < parameters.min_length:
        return NotFound("what was found does not come from outside the field of view")
    ends = np.linspace(extent.start, extent.tip, parameters.order)
    return SearchRegion(
        curve=NeedleCurve(fit.axis.position(ends)),
        radius=2 * parameters.margin,
        before=parameters.search_reach,
        beyond=parameters.margin,
        shaft_beyond=0.0,
        max_angle=math.radians(2 * parameters.max_angle_deg),
        followed=region.followed + 1,
    )
