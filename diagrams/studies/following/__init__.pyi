from .analysis import Run as Run
from .cases import run_case as run_case
