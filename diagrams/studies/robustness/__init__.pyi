from .logged_tracker import MakeLoggedTracker as MakeLoggedTracker
from .planned_motion import PlannedMotion as PlannedMotion
from .reproduction import reproduce as reproduce
from .reproduction import study_cases as study_cases
from .search_path import MakeSearchingTracker as MakeSearchingTracker
from .search_path import SearchPath as SearchPath
