from .experiments import reproduce as reproduce
from .experiments import study_cases as study_cases
from .logged_tracker import MakeLoggedTracker as MakeLoggedTracker
from .planned_motion import PlannedMotion as PlannedMotion
from .search_path import MakeSearchingTracker as MakeSearchingTracker
from .search_path import SearchPath as SearchPath
