"""Threads of the libraries below, which compete with ours for the cores."""

import os

LINEAR_ALGEBRA = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables that set the number of threads of the libraries NumPy and SciPy may compute with."""


def limit_threads() -> None:
    """Let linear algebra run in the thread that calls it, and idle threads sleep.

    Our matrices are so small that a second thread costs more than it computes, and both OpenBLAS
    and OpenMP keep idle threads spinning on cores that rendering needs. The libraries read these
    variables once, so this must run before NumPy is imported. What the user has set stays.
    """
    if "OMP_NUM_THREADS" not in os.environ:  # which they read where their own is not set
        for name in LINEAR_ALGEBRA:
            os.environ.setdefault(name, "1")
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
