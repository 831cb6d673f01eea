"""Tracker of Chatelain 2013 as published, with nothing of ours."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from pydrake.systems.framework import Diagram

from sonoservo.diagrams.papers.chatelain2013.method.detection import PublishedDetectionParameters
from sonoservo.diagrams.papers.chatelain2013.method.insertion_detector import InsertionDetector
from sonoservo.diagrams.papers.chatelain2013.method.lifecycle import PublishedLifecycle
from sonoservo.diagrams.papers.chatelain2013.method.localization import (
    PublishedLocalizationParameters,
    explain_published_localization,
)
from sonoservo.diagrams.trackers.tracker_parts import VOLUME_GATE, TrackerParameters, connect_parts
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.control_point_filter import ControlPointFilter
from sonoservo.systems.tracking.needle_filter import NeedleFilter, require_order
from sonoservo.systems.tracking.needle_localizer import NeedleLocalizer
from sonoservo.systems.tracking.needle_motion import NeedleMotionParameters
from sonoservo.systems.tracking.track_manager import TrackManager
from sonoservo.systems.tracking.volume_gate import VolumeGate
from sonoservo.systems.tracking.volume_memory import VolumeMemory


def _published_filter() -> ControlPointFilter:
    return ControlPointFilter(motion=NeedleMotionParameters(insertion=0, body=0, bending=5e-5))


@dataclass(kw_only=True)
class Chatelain2013AsPublishedParameters(TrackerParameters):
    """Parameters of the tracker of Chatelain 2013 as published; see `TrackerParameters`.

    One admissible entry point starts the track, the filter works in the probe's frame, and nothing
    checks a measurement or finds a lost needle again. The paper publishes no values. Where it is
    silent, the choice is named with the parameter or the function.

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
            localize=partial(explain_published_localization, parameters=parameters.localization),
            seed=seed,
        ),
        period=period,
        offset=offset,
    )
    return builder.Build()


def add_published_parts(
    builder: DiagramBuilder,
    *,
    parameters: TrackerParameters,
    detection: PublishedDetectionParameters,
    needle_filter: NeedleFilter[Any],
    localizer: NeedleLocalizer,
    period: float,
    offset: float,
) -> TrackManager:
    """Add and connect the parts of a tracker as published, export its ports, return its manager."""
    events: dict[str, Any] = {"period": period, "offset": offset}
    lifecycle = PublishedLifecycle(order=parameters.order, needle_filter=needle_filter)
    manager = connect_parts(
        builder,
        gate=VolumeGate(parameters=parameters.plausibility, **events),
        localizer=localizer,
        manager=TrackManager(lifecycle=lifecycle, **events),
    )
    same = detection.same_direction
    memory = builder.AddNamedSystem(
        "volume_memory", VolumeMemory(same_direction=same, kinds=(Volume,), **events)
    )
    detector = builder.AddNamedSystem("insertion_detector", InsertionDetector(parameters=detection))
    gate = builder.GetSubsystemByName(VOLUME_GATE)
    for each in (memory, detector):
        builder.Connect(gate.GetOutputPort("volume"), each.GetInputPort("volume"))
    previous = memory.GetOutputPort("previous_volume")
    builder.Connect(previous, detector.GetInputPort("previous_volume"))
    builder.Connect(detector.GetOutputPort("detection"), manager.GetInputPort("detection"))
    return manager


PUBLISHED = {Chatelain2013AsPublishedParameters: MakeChatelain2013AsPublishedTracker}
"""Function that makes the tracker, by the class of its parameters."""
