from .phantom import Phantom as Phantom
from .phantom import StraightNeedle as StraightNeedle
from .reproduction import reproduce as reproduce
from .tracking import BMode as BMode
from .tracking import Tracked as Tracked
from .tracking import Tracking as Tracking
from .tracking import localize_as_published as localize_as_published
from .tracking import tracker_parameters as tracker_parameters
