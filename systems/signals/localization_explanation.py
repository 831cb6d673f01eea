"""Explanation of a localization: all intermediate results in one volume."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, NotFound, Shape, Vector3
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.requirements import Fraction
from sonoservo.systems.signals.tissue_record import TissueRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SearchRegion(Immutable):
    """Part of a volume in which a needle is localized; positions in W, lengths in m."""

    curve: NeedleCurve
    """Curve around which to search, with as many control points as the needle's."""

    radius: float
    """Radius of the capsule around the curve."""

    before: float
    """Distance by which the profile along the needle extends past the curve's entry."""

    beyond: float
    """Distance by which the profile along the needle extends past the curve's tip."""

    shaft_beyond: float
    """Distance past the curve's tip up to which voxels count as candidates for the shaft."""

    max_angle: float
    """Largest angle between the needle and the curve, in rad."""

    entry: Vector3 | None = None
    """Position of the entry; None if it is unknown."""

    tissue: TissueRecord | None = None
    """Tissue along the needle from before it came; None if unknown."""


@dataclass(frozen=True, eq=False)
class AxisProfile(Immutable):
    """Intensity along an axis, by abscissa."""

    a: Annotated[Floats, Shape("m")]
    """Evenly spaced abscissae in m."""

    p_W: Annotated[Floats, Shape("m", 3)]
    """Positions on the axis in W, in m."""

    level: Annotated[Floats, Shape("m")]
    """Maximum in a tube around the axis, in dB."""

    background: Annotated[Floats, Shape("m")]
    """The same beside the axis."""

    seen: Annotated[NDArray[np.bool_], Shape("m", dtype=np.bool_)]
    """Flags of the samples in the field of view."""

    beam_width: Floats | None = None
    """(m,) full width at half maximum of the needle's blurred end, in m; None if unknown."""

    contrast: float | None = None
    """Level over the background that speaks neither for nor against a needle, in dB; None if
    unknown."""

    incidence: Floats | None = None
    """(m,) angles in rad by which the sound's direction differs from a right angle to the axis;
    None if unknown."""

    white: float = math.inf
    """Level of white in dB."""

    before: Floats | None = None
    looks: Floats | None = None
    """(m,) contrasts in dB that the tissue had there before the needle came, and number of looks at
    each; None if unknown. See `TissueRecord`."""


@dataclass(frozen=True, eq=False)
class NeedleExtent(Immutable):
    """Stretch over which a needle is visible along its axis, and where its tip is, in m."""

    start: float
    end: float
    """Abscissae between which the needle stands out."""

    tip: float
    tip_std: float
    """Abscissa of the end that is taken for the tip, and its standard deviation."""

    bevel: float
    bevel_std: float
    """Length of the part of the bevel that is not seen beyond the end, and its standard deviation.
    It stays as long as the bevel is turned as it is, and is not part of ``tip_std``."""

    unseen: float
    """Probability that a needle which goes on beyond the end is not seen there."""

    seen: float
    """Probability that this is the end."""

    elsewhere: Annotated[Floats, Shape(None, 3)]
    """Other places where the needle may end: probabilities, abscissae relative to ``tip`` and
    standard deviations."""

    entered: float
    """Abscissa at which the axis enters the field of view; -inf if before the profile begins."""

    leaves: bool
    """Whether the needle leaves the field of view."""

    evidence: float
    """Integral along the stretch of the evidence for a needle, in dB m. It is about 2 dB times the
    length. Lines through speckle reach 6 dB mm, and a needle of 5 mm reaches 12 to 30 dB mm."""

    contrast: Annotated[Floats, Shape("m")]
    """Smoothed level of the profile over its background, in dB."""

    ahead: Annotated[NDArray[np.bool_], Shape("m", dtype=np.bool_)]
    """Flags of the samples where the tip has surely not been."""

    as_before: Fraction
    """Probability that the tissue is where it was before the needle came."""


@dataclass(frozen=True, eq=False)
class LocalizationAttempt(Immutable):
    """One search for the needle in one region; what an attempt did not reach is None."""

    region: SearchRegion

    measurement: NeedleMeasurement | NotFound
    """Needle, or the reason why it was not found in the region."""

    candidates: Annotated[Floats, Shape("m", 3)] | None = None
    """Positions of the candidate voxels in W, in m."""

    weights: Annotated[Floats, Shape("m")] | None = None

    inliers: Annotated[NDArray[np.bool_], Shape("m", dtype=np.bool_)] | None = None
    """Flags of the candidates in the consensus."""

    profile: AxisProfile | None = None
    """Intensity along the axis found last."""

    extent: NeedleExtent | None = None
    """Stretch of the profile that counts as the needle."""


@dataclass(frozen=True, eq=False)
class LocalizationExplanation(Immutable):
    """All intermediate results of a localization in one volume."""

    volume_time: float
    """Time of the volume, in s."""

    prediction: NeedlePrediction | NotFound
    """Expected needle, or the reason why none was expected."""

    attempts: tuple[LocalizationAttempt, ...]
    """Searches in the order in which they were made: one around a prediction, and another in a
    narrow region if that failed; several for a needle that was lost or never seen."""

    measurement: NeedleMeasurement | NotFound
    """Best result among the attempts, or the reason why there is none."""

    probability: float = 0.0
    """Probability that the line found in the whole volume is a needle; 0 if there is no line, or if
    the needle was predicted."""

    innovation: float | None = None
    """Mahalanobis distance of the measurement from its prediction; None, as the next one, until a
    filter has compared them."""

    gate: float | None = None
    """Largest accepted distance."""
