"""Parameters of the needle localizer."""

from dataclasses import dataclass, field, replace

from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
    Positive,
)
from sonoservo.systems.tracking.ransac import RansacParameters
from sonoservo.systems.tracking.tip import TipParameters


@dataclass(kw_only=True)
class NeedleLocalizerParameters(Bounded):
    """Search regions and acceptance thresholds of the localizer. The paper publishes no values.

    Parameters
    ----------
    margin
        Margin around the predicted curve, beyond three standard deviations, in m.
    margin_growth
        Additional margin for every volume that did not confirm the needle, in m.
    max_radius
        Largest radius of the volume of interest, in m.
    max_angle_deg
        Largest angle alpha_0 from the predicted direction, in degrees. The prediction's uncertainty
        is added to it.
    cross_section
        Area of the candidates across the needle, in m^2.
    slab
        Length of needle over which the candidates share a threshold, in m.
    min_length
        Smallest visible length of the needle, in m.
    search_reach
        Distance to search outwards along a line for its entry, in m.
    min_probability
        Smallest probability at which a line in the whole volume counts as a needle.
    min_evidence
        Smallest evidence along the needle, in dB m; see `NeedleExtent`.
    correlation_length
        Length of needle that one beam width blurs into one observation, in m.
    tip_std
        Standard deviation of the tip along the axis in addition to that of its extent, in m; see
        `NeedleExtent`.
    entry_std
        Standard deviation of the entry along the axis, in m. A volume does not show that position.
        The entry is at rest, so its last position is taken as measured. If its predicted position
        were taken, nothing would ever contradict a velocity along the axis.
    echo_offset, echo_offset_std
        Distance from the centre of the needle's echo to its axis, away from the probe, in m, and
        its standard deviation, as the gauge is unknown. Most of the sound returns from the front
        wall. The rest is reflected to and fro inside.
    systematic_std
        Standard deviation added to every control point in every direction, in m.
    volume_of_interest
        Whether only the surroundings of the prediction are searched. If not, the whole volume is.
    angle_gate
        Whether an axis must agree with the predicted direction (eq. 22).
    sweep_time
        Whether each frame counts as acquired at its own time, from the probe's pose at that time.
        If not, the whole volume counts as acquired at its middle.
    ransac
        Parameters of the random sample consensus.
    tip
        Parameters of the search for the needle's ends.
    """

    margin: Positive = 3e-3
    margin_growth: Positive = 2e-3
    max_radius: Positive = 20e-3
    max_angle_deg: Positive = 10.0
    cross_section: Positive = 4e-6
    slab: Positive = 2e-3
    min_length: Positive = 4e-3
    search_reach: Positive = 40e-3
    min_probability: Positive = 0.5
    min_evidence: Positive = 12e-3
    correlation_length: Positive = 2e-3
    tip_std: Positive = 0.25e-3
    entry_std: Positive = 1e-3
    echo_offset: float = 0.4e-3
    echo_offset_std: NotNegative = 0.2e-3
    systematic_std: Positive = 0.1e-3
    volume_of_interest: bool = True
    angle_gate: bool = True
    sweep_time: bool = True
    ransac: RansacParameters = field(default_factory=RansacParameters)
    tip: TipParameters = field(default_factory=TipParameters)

    def knowing(
        self, *, beam_width: float | None = None, echo_offset: float | None = None
    ) -> "NeedleLocalizerParameters":
        """Return the parameters with what a user knows about probe and needle.

        Parameters
        ----------
        beam_width
            Width of the beam along the needle at half amplitude, in m, for volumes that do not
            carry their point spread; None if unknown.
        echo_offset
            Distance from the centre of the needle's echo to its axis, in m; None if unknown.
        """
        known = self
        if beam_width is not None:
            known = replace(known, tip=replace(known.tip, beam_width=beam_width))
        if echo_offset is not None:
            known = replace(known, echo_offset=echo_offset, echo_offset_std=0.0)
        return known
