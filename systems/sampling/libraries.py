"""Settings of the libraries below us, which they read once, when they are loaded.

What the user has set in the environment stays.
"""

import os
from contextlib import suppress
from pathlib import Path

LINEAR_ALGEBRA = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables that set the number of threads of the libraries NumPy and SciPy may compute with."""

_WIDE = ("X86_V4", "AVX512F", "AVX512CD", "AVX512_SKX", "AVX512_ICL", "AVX512_SPR")
"""NumPy's names of what x86-64-v4 has over x86-64-v3; each version knows some of them."""


def prepare_libraries() -> None:
    """Set threads and instructions of the libraries; call this before NumPy is imported.

    Linear algebra runs in the thread that calls it, and idle threads of OpenMP sleep: our matrices
    are so small that a second thread costs more than it computes, and idle ones would spin on cores
    that rendering needs. With AVX-512, NumPy's functions and OpenBLAS would round otherwise than
    with AVX2, which gives the same bits on all processors that have it.
    """
    if "OMP_NUM_THREADS" not in os.environ:  # which they read where their own is not set
        for name in LINEAR_ALGEBRA:
            os.environ.setdefault(name, "1")
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    if _has_avx512():
        os.environ.setdefault("NPY_DISABLE_CPU_FEATURES", " ".join(_WIDE))
        os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")


def _has_avx512() -> bool:
    with suppress(OSError), Path("/proc/cpuinfo").open(encoding="ascii", errors="replace") as lines:
        return any("avx512f" in line.split() for line in lines if line.startswith("flags"))
    return False
