from .cases import run_case as run_case
