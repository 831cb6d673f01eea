"""Explanation of a localization: all intermediate results in one volume."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, NotFound, read_only
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction


@dataclass(frozen=True, eq=False)
class SearchRegion(Immutable):
    """Part of a volume in which a needle is localized.

    Parameters
    ----------
    curve
        Curve in W around which to search, with as many control points as the needle's.
    radius
        Radius of the capsule around the curve, in m.
    before, beyond
        Distances by which the profile along the needle extends past the curve's ends, in m.
    shaft_beyond
        Distance past the curve's tip up to which voxels count as candidates for the shaft, in m.
    max_angle
        Largest angle between the needle and the curve, in rad.
    entry
        (3,) position of the entry in W, in m; None if it is unknown.
    """

    curve: NeedleCurve
    radius: float
    before: float
    beyond: float
    shaft_beyond: float
    max_angle: float
    entry: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class AxisProfile(Immutable):
    """Intensity along an axis.

    Parameters
    ----------
    a
        (m,) abscissae in m, evenly spaced.
    p_W
        (m, 3) positions on the axis in W, in m.
    level, background
        (m,) maximum in a tube around the axis, and the same beside the axis, in dB.
    seen
        (m,) flags of the samples in the field of view.
    beam_width
        (m,) full width at half maximum of the needle's blurred end, in m; None if unknown.
    contrast
        Level over the background that speaks neither for nor against a needle, in dB; None if
        unknown.
    incidence
        (m,) angles in rad by which the sound's direction differs from a right angle to the axis;
        None if unknown.
    """

    a: NDArray[np.float64]
    p_W: NDArray[np.float64]
    level: NDArray[np.float64]
    background: NDArray[np.float64]
    seen: NDArray[np.bool_]
    beam_width: NDArray[np.float64] | None = None
    contrast: float | None = None
    incidence: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        m = len(self.a)
        for name, shape in (("a", (m,)), ("p_W", (m, 3)), ("level", (m,)), ("background", (m,))):
            object.__setattr__(self, name, read_only(getattr(self, name), name, shape))
        object.__setattr__(self, "seen", read_only(self.seen, "seen", (m,), np.bool_))


@dataclass(frozen=True, eq=False)
class NeedleExtent(Immutable):
    """Stretch over which a needle is visible along its axis, and where its tip is.

    Parameters
    ----------
    start, end
        Abscissae between which the needle stands out, in m.
    tip, tip_std
        Abscissa of the end that is taken for the tip and its standard deviation, in m.
    bevel_std
        Standard deviation in m of the part of the bevel that is not seen beyond the end. It stays
        as long as the needle is turned as it is, and is not part of ``tip_std``.
    unseen
        Probability that a needle which goes on beyond the end is not seen there.
    seen
        Probability that this is the end.
    elsewhere
        (c, 3) other places where the needle may end: probabilities, abscissae relative to ``tip``
        and standard deviations, in m.
    entered
        Abscissa in m at which the axis enters the field of view; -inf if it enters before the
        profile begins.
    leaves
        Whether the needle leaves the field of view.
    evidence
        Integral along the stretch of the evidence for a needle, in dB m. It is about 2 dB times the
        length. Lines through speckle reach 6 dB mm, and a needle of 5 mm reaches 12 to 30 dB mm.
    """

    start: float
    end: float
    tip: float
    tip_std: float
    bevel_std: float
    unseen: float
    seen: float
    elsewhere: NDArray[np.float64]
    entered: float
    leaves: bool
    evidence: float


@dataclass(frozen=True, eq=False)
class LocalizationAttempt(Immutable):
    """One search for the needle in one region of a volume.

    The results of steps that an attempt did not reach are None.

    Parameters
    ----------
    region
        Part of the volume that was searched.
    measurement
        Needle, or the reason why it was not found in the region.
    candidates, weights
        (m, 3) positions in W, in m, and (m,) weights of the candidate voxels.
    inliers
        (m,) flags of the candidates in the consensus.
    profile
        Intensity along the axis found last.
    extent
        Stretch of the profile that counts as the needle.
    """

    region: SearchRegion
    measurement: NeedleMeasurement | NotFound
    candidates: NDArray[np.float64] | None = None
    weights: NDArray[np.float64] | None = None
    inliers: NDArray[np.bool_] | None = None
    profile: AxisProfile | None = None
    extent: NeedleExtent | None = None

    def __post_init__(self) -> None:
        if self.candidates is None:
            return
        m = len(self.candidates)
        for name, shape, dtype in (
            ("candidates", (m, 3), np.float64),
            ("weights", (m,), np.float64),
            ("inliers", (m,), np.bool_),
        ):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, read_only(value, name, shape, dtype))


@dataclass(frozen=True, eq=False)
class LocalizationExplanation(Immutable):
    """All intermediate results of a localization in one volume.

    Parameters
    ----------
    volume_time
        Time of the volume, in s.
    prediction
        Expected needle, or the reason why none was expected.
    attempts
        Searches in the order in which they were made: one around a prediction, and another in a
        narrow region if that failed; several for a needle that was lost or never seen.
    measurement
        Best result among the attempts, or the reason why there is none.
    probability
        Probability that the line found in the whole volume is a needle; 0 if there is no line, or
        if the needle was predicted.
    innovation, gate
        Mahalanobis distance of the measurement from its prediction, and the largest accepted
        distance; None until a filter has compared them.
    """

    volume_time: float
    prediction: NeedlePrediction | NotFound
    attempts: tuple[LocalizationAttempt, ...]
    measurement: NeedleMeasurement | NotFound
    probability: float = 0.0
    innovation: float | None = None
    gate: float | None = None
