"""Tracker of Chatelain 2013 as published, with nothing of ours."""

from dataclasses import dataclass, field

from pydrake.systems.framework import Diagram, DiagramBuilder

from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters, add_published_parts
from sonoservo.systems.detection.published_detection import PublishedDetectionParameters
from sonoservo.systems.estimation.control_point_filter import ControlPointFilter
from sonoservo.systems.estimation.needle_filter import require_order
from sonoservo.systems.estimation.needle_motion import NeedleMotionParameters
from sonoservo.systems.localization.needle_localizer import NeedleLocalizer
from sonoservo.systems.localization.published_localization import (
    PublishedLocalizationParameters,
    explain_published_localization,
)


def _published_filter() -> ControlPointFilter:
    return ControlPointFilter(motion=NeedleMotionParameters(insertion=0, body=0, bending=5e-5))


@dataclass(kw_only=True)
class Chatelain2013AsPublishedParameters(TrackerParameters):
    """Parameters of the tracker of Chatelain 2013 as published; see `TrackerParameters`.

    Consecutive sweeps of one direction are compared, one admissible entry point starts the track,
    the filter works in the probe's frame, and nothing checks a measurement or finds a lost needle
    again. The paper publishes no values. Where it is silent, the choice is named with the parameter
    or the function.

    Parameters
    ----------
    kind
        "chatelain2013_as_published".
    detection
        Thresholds of section II-B.
    localization
        Region, thresholds and noise of section II-D.
    filter
        Filter of section II-C, with the same noise Q for every control point in every direction.
    """

    kind: str = "chatelain2013_as_published"
    detection: PublishedDetectionParameters = field(default_factory=PublishedDetectionParameters)
    localization: PublishedLocalizationParameters = field(
        default_factory=PublishedLocalizationParameters
    )
    filter: ControlPointFilter = field(default_factory=_published_filter)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_order(self.order, self.filter)


def MakeChatelain2013AsPublishedTracker(
    *,
    parameters: Chatelain2013AsPublishedParameters,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
) -> Diagram:
    """Make the tracker of Chatelain 2013 as published; see `MakeNeedleTracker`."""
    builder = DiagramBuilder()
    add_published_parts(
        builder,
        parameters=parameters,
        detection=parameters.detection,
        needle_filter=parameters.filter,
        localizer=NeedleLocalizer(
            parameters=parameters.localization, seed=seed, method=explain_published_localization
        ),
        min_length=parameters.localization.min_length,
        period=period,
        offset=offset,
    )
    return builder.Build()
