from .analysis import Run as Run
from .analysis import Volumes as Volumes
from .cases import run_case as run_case
