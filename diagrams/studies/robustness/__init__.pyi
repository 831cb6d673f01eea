from .planned_motion import MakeMeasuredMotion as MakeMeasuredMotion
from .planned_motion import PlannedMotion as PlannedMotion
from .reproduction import reproduce as reproduce
from .reproduction import study_cases as study_cases
from .search_path import SearchPath as SearchPath
