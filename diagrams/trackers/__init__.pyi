from .chatelain2013 import Chatelain2013TrackerParameters as Chatelain2013TrackerParameters
from .chatelain2013 import MakeChatelain2013Tracker as MakeChatelain2013Tracker
from .chatelain2013_as_published import (
    Chatelain2013AsPublishedParameters as Chatelain2013AsPublishedParameters,
)
from .chatelain2013_as_published import (
    MakeChatelain2013AsPublishedTracker as MakeChatelain2013AsPublishedTracker,
)
from .tracker_parts import CommonTrackerParameters as CommonTrackerParameters
from .tracker_parts import TrackerParameters as TrackerParameters
from .tracker_parts import add_tracker_parts as add_tracker_parts
from .zhao2012 import MakeZhao2012Tracker as MakeZhao2012Tracker
from .zhao2012 import Zhao2012TrackerParameters as Zhao2012TrackerParameters
