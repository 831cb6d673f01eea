"""Speed of the tip from the displacement of the needle's end between two volumes."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.requirements import Positive, check_bounds, require
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.signals.volume import Volume, acquired_from
from sonoservo.systems.tracking.axis import axis_through
from sonoservo.systems.tracking.tip import TipParameters, axis_profile, find_extent


@dataclass(kw_only=True)
class EdgeVelocimeterParameters:
    """Parameters of the velocimeter that follows the needle's end.

    A steel needle's echo and the tissue rest while the needle slides, so speckle tracking measures
    too low a speed. The end of the needle does move.

    Parameters
    ----------
    kind
        Name of the velocimeter, always "edge".
    behind, beyond
        Distances from the predicted tip over which the intensity is sampled, in m.
    across_std
        Standard deviation of the velocity across the needle, which is not measured, in m/s.
    profile
        Parameters of the search for the needle's ends.
    """

    kind: str = "edge"
    behind: Positive = 20e-3
    beyond: Positive = 8e-3
    across_std: Positive = 20e-3
    profile: TipParameters = field(default_factory=TipParameters)

    def __post_init__(self) -> None:
        require(self.kind == "edge", "kind", self.kind, '"edge"')
        check_bounds(self)


def measure_edge_velocity(
    current: Volume | RadioFrequencySweep,
    previous: Volume | RadioFrequencySweep,
    p_WBefore: NDArray[np.float64],
    p_WPredicted: NDArray[np.float64],
    direction: NDArray[np.float64],
    parameters: EdgeVelocimeterParameters,
) -> VelocityMeasurement | NotFound:
    """Measure the tip's velocity in W by the ends of two profiles along one and the same axis.

    Errors of the axis and the bias of the end cancel in the difference. A faint end, which may be
    misplaced, counts little by its standard deviation.
    """
    if not isinstance(current, Volume) or not isinstance(previous, Volume):
        return NotFound("the end of a needle is followed in volumes only")
    rear = p_WPredicted - parameters.behind * direction
    axis = axis_through(np.stack([rear, p_WPredicted]))
    assert not isinstance(axis, NotFound)
    tips, stds, times = [], [], []
    for volume in (previous, current):
        stop = parameters.behind + parameters.beyond
        profile = axis_profile(volume, axis, 0.0, stop, parameters.profile)
        # Where on its bevel the needle seems to end does not change from one volume to the next.
        extent = find_extent(profile, replace(parameters.profile, bevel_length=0.0))
        if isinstance(extent, NotFound):
            return extent
        if extent.leaves:
            return NotFound("the tip lies outside the field of view")
        at = acquired_from(volume, axis.position(np.array([extent.tip])))
        tips.append(extent.tip)
        stds.append(extent.tip_std)
        times.append(float(volume.to_world(at)[1][0]))
    elapsed = times[1] - times[0]
    if not elapsed > 0:
        return NotFound("the volumes were acquired at the same time")
    speed = (tips[1] - tips[0]) / elapsed
    along = np.outer(direction, direction)
    covariance = (np.hypot(stds[0], stds[1]) / elapsed) ** 2 * along
    covariance = covariance + parameters.across_std**2 * (np.eye(3) - along)
    return VelocityMeasurement(speed * direction, covariance, 1.0)
