"""Registry of the needle trackers, from which a scenario's field ``tracker`` selects one."""

from collections.abc import Callable
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

from pydrake.systems.framework import Diagram

from sonoservo.diagrams.trackers.chatelain2013 import (
    Chatelain2013TrackerParameters,
    MakeChatelain2013Tracker,
)
from sonoservo.diagrams.trackers.chatelain2013_as_published import (
    Chatelain2013AsPublishedParameters,
    MakeChatelain2013AsPublishedTracker,
)
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.diagrams.trackers.zhao2012 import MakeZhao2012Tracker, Zhao2012TrackerParameters
from sonoservo.diagrams.trackers.zhao2012_as_published import (
    MakeZhao2012AsPublishedTracker,
    Zhao2012AsPublishedParameters,
)

TRACKERS: dict[type[TrackerParameters], Callable[..., Diagram]] = {
    Chatelain2013TrackerParameters: MakeChatelain2013Tracker,
    Chatelain2013AsPublishedParameters: MakeChatelain2013AsPublishedTracker,
    Zhao2012TrackerParameters: MakeZhao2012Tracker,
    Zhao2012AsPublishedParameters: MakeZhao2012AsPublishedTracker,
}
"""Function that makes each tracker, by the class of its parameters."""

if TYPE_CHECKING:
    AnyTrackerParameters = TrackerParameters
else:
    AnyTrackerParameters = reduce(or_, TRACKERS)
    """Type of a YAML field whose ``kind`` selects the tracker."""
