"""Registry of the needle trackers, among which a scenario's field ``tracker`` chooses."""

from collections.abc import Callable
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

from pydrake.systems.framework import Diagram

from sonoservo.diagrams.trackers.chatelain2013 import (
    Chatelain2013TrackerParameters,
    MakeChatelain2013Tracker,
)
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.diagrams.trackers.zhao2012 import MakeZhao2012Tracker, Zhao2012TrackerParameters

TRACKERS: dict[type[TrackerParameters], Callable[..., Diagram]] = {
    Chatelain2013TrackerParameters: MakeChatelain2013Tracker,
    Zhao2012TrackerParameters: MakeZhao2012Tracker,
}
"""Parameters of each tracker and the function that makes it; a new one is a file and a line."""

if TYPE_CHECKING:
    AnyTrackerParameters = TrackerParameters
else:
    AnyTrackerParameters = reduce(or_, TRACKERS)
    """Type of a field of a YAML file whose ``kind`` chooses the tracker."""
