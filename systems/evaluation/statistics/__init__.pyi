from .intervals import Interval as Interval
from .intervals import bootstrap_interval as bootstrap_interval
from .intervals import proportion_interval as proportion_interval
from .run_intervals import count_interval as count_interval
from .run_intervals import mean_interval as mean_interval
from .run_intervals import run_interval as run_interval
