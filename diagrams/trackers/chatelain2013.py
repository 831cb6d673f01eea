"""Tracker of Chatelain 2013: detector, localizer, and a filter on the needle's control points."""

from dataclasses import dataclass, field

from pydrake.systems.framework import Diagram

from sonoservo.diagrams.trackers.tracker_parts import (
    CommonTrackerParameters,
    add_tracker_parts,
)
from sonoservo.systems.signals.ports import DiagramBuilder
from sonoservo.systems.tracking.interacting_filter import InteractingFilter
from sonoservo.systems.tracking.needle_filter import AnyFilter, require_order


@dataclass(kw_only=True)
class Chatelain2013TrackerParameters(CommonTrackerParameters):
    """Parameters of our tracker after Chatelain 2013; see `CommonTrackerParameters` for the others.

    Parameters
    ----------
    kind
        "chatelain2013".
    filter
        Filter of the track: by default "interacting"; "control_points" is the paper's.
    """

    kind: str = "chatelain2013"
    filter: AnyFilter = field(default_factory=InteractingFilter)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_order(self.order, self.filter)


def MakeChatelain2013Tracker(
    *,
    parameters: Chatelain2013TrackerParameters,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
) -> Diagram:
    """Make the tracker of Chatelain 2013; see `MakeNeedleTracker`."""
    builder = DiagramBuilder()
    add_tracker_parts(
        builder,
        parameters=parameters,
        needle_filter=parameters.filter,
        period=period,
        offset=offset,
        seed=seed,
    )
    return builder.Build()
