from .intervals import Interval as Interval
from .intervals import bootstrap_interval as bootstrap_interval
from .intervals import proportion_interval as proportion_interval
