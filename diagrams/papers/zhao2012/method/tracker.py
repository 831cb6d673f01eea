"""Tracker of Zhao 2012 as published, with nothing of ours."""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Diagram

from sonoservo.diagrams.papers.chatelain2013.method.detection import PublishedDetectionParameters
from sonoservo.diagrams.papers.chatelain2013.method.tracker import add_published_parts
from sonoservo.diagrams.papers.zhao2012.method.whole_volume_ransac import (
    WholeVolumeLocalizationParameters,
    explain_whole_volume_localization,
)
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.diagrams.trackers.zhao2012 import connect_velocimeter
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter
from sonoservo.systems.tracking.needle_filter import require_order
from sonoservo.systems.tracking.needle_localizer import NeedleLocalizer
from sonoservo.systems.tracking.needle_motion import NeedleMotionParameters
from sonoservo.systems.tracking.ransac import RansacParameters
from sonoservo.systems.tracking.speckle_velocimeter import (
    Speckle,
    SpeckleVelocimeter,
    SpeckleVelocimeterParameters,
    measure_velocity,
)
from sonoservo.systems.tracking.volume_memory import VolumeMemory


def _published_localization() -> WholeVolumeLocalizationParameters:
    return WholeVolumeLocalizationParameters(
        candidate_volume=1000e-9,
        max_gap=3e-3,
        end_contrast=9.0,
        ransac=RansacParameters(
            residual_threshold=0.75e-3, refits=1, draws_factor=1.0, max_trials=20000
        ),
    )


def _published_windows() -> SpeckleVelocimeterParameters:
    return SpeckleVelocimeterParameters(
        kernel=[15, 3, 7], search=[27, 5, 11], min_correlation=1e-6, max_distance=1.0
    )


def _published_filter() -> AxisTipFilter:
    return AxisTipFilter(
        motion=NeedleMotionParameters(insertion=0, body=5e-5),
        first_speed_std=0.1,
        first_drift_std=0.1,
        velocity_gate=1 - 1e-12,
    )


@dataclass(kw_only=True)
class Zhao2012AsPublishedParameters(TrackerParameters):
    """Parameters of the tracker of Zhao 2012 as published; see `TrackerParameters`.

    Each volume is searched as a whole, without regard to the prediction. The filter works in the
    probe's frame, and nothing checks a measurement. The paper's needle is always in view. It is
    silent on how a needle is first found and when a track ends, so both are as published in
    Chatelain 2013. It publishes no values but the windows.

    Parameters
    ----------
    kind
        "zhao2012_as_published".
    detection
        Thresholds of Chatelain 2013, section II-B.
    localization
        Thresholds and noise of section 2.2. The number of voxels and f_0 are those that gave the
        most right lines in whole volumes of fig. 5 of Chatelain 2013, on seeds from 100 on: with
        less than 500 mm^3 or more than 1 mm, bright spots in the tissue win. A steel needle is some
        20 dB brighter where a scan line meets it at a right angle, so it ends 9 dB above its
        surroundings, as in Chatelain 2013 as published.
    velocimeter
        Windows of section 2.3. The published windows are 7 planes, 21 lines and 51 samples in 11,
        37 and 61. The default windows have the same extents at a depth of 50 mm in voxels of
        0.7 mm, but the search reaches one voxel in depth, as less could not be interpolated. Both
        windows lie around the known tip, and the best match counts however badly it correlates.
    filter
        Filter of section 2.1, with the same noise Q in every direction. Its first velocity is
        unknown, so that the second volume's is the difference of two tips. Nothing gates a
        velocity.
    """

    kind: str = "zhao2012_as_published"
    detection: PublishedDetectionParameters = field(default_factory=PublishedDetectionParameters)
    localization: WholeVolumeLocalizationParameters = field(default_factory=_published_localization)
    velocimeter: SpeckleVelocimeterParameters = field(default_factory=_published_windows)
    filter: AxisTipFilter = field(default_factory=_published_filter)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_order(self.order, self.filter)


def measure_velocity_as_published(
    current: Speckle,
    previous: Speckle,
    p_WBefore: NDArray[np.float64],
    p_WPredicted: NDArray[np.float64],
    direction: NDArray[np.float64],
    parameters: SpeckleVelocimeterParameters,
) -> VelocityMeasurement | NotFound:
    """Measure the velocity with both windows around the known tip, as printed in Zhao 2012, 2.3."""
    return measure_velocity(current, previous, p_WBefore, p_WBefore, direction, parameters)


def MakeZhao2012AsPublishedTracker(
    *,
    parameters: Zhao2012AsPublishedParameters,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
) -> Diagram:
    """Make the tracker of Zhao 2012 as published; see `MakeNeedleTracker`."""
    builder = DiagramBuilder()
    manager = add_published_parts(
        builder,
        parameters=parameters,
        detection=parameters.detection,
        needle_filter=parameters.filter,
        localizer=NeedleLocalizer(
            localize=partial(explain_whole_volume_localization, parameters=parameters.localization),
            seed=seed,
        ),
        period=period,
        offset=offset,
    )
    velocimeter = SpeckleVelocimeter(
        measure=partial(measure_velocity_as_published, parameters=parameters.velocimeter)
    )
    connect_velocimeter(builder, manager, velocimeter, VolumeMemory(period=period, offset=offset))
    return builder.Build()


PUBLISHED = {Zhao2012AsPublishedParameters: MakeZhao2012AsPublishedTracker}
"""Function that makes the tracker, by the class of its parameters."""
