from .analysis import Run as Run
from .analysis import run_case as run_case
