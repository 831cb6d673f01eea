"""Registry of the needle trackers, from which a scenario's field ``tracker`` selects one."""

from collections.abc import Callable
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

from pydrake.systems.framework import Diagram

from sonoservo.diagrams.published import published
from sonoservo.diagrams.trackers.chatelain2013 import (
    Chatelain2013TrackerParameters,
    MakeChatelain2013Tracker,
)
from sonoservo.diagrams.trackers.tracker_parts import TrackerParameters
from sonoservo.diagrams.trackers.zhao2012 import MakeZhao2012Tracker, Zhao2012TrackerParameters

TRACKERS: dict[type[TrackerParameters], Callable[..., Diagram]] = {
    Chatelain2013TrackerParameters: MakeChatelain2013Tracker,
    Zhao2012TrackerParameters: MakeZhao2012Tracker,
    **published("tracker"),
}
"""Function that makes each tracker, by the class of its parameters; the papers add theirs."""

if TYPE_CHECKING:
    AnyTrackerParameters = TrackerParameters
else:
    AnyTrackerParameters = reduce(or_, TRACKERS)
    """Type of a YAML field whose ``kind`` selects the tracker."""
