"""Threads that run compiled kernels beside the calling thread."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

from joblib import cpu_count
from numba import config


@cache
def workers() -> ThreadPoolExecutor | None:
    """Return the threads for kernels, one per core; None if there is only one.

    The cores are those that this process may use, by its affinity, its container's share and
    Numba's setting. Kernels release the GIL, so they also run beside Drake and Python. A task must
    not wait for another one.
    """
    threads = min(int(config.NUMBA_NUM_THREADS), cpu_count())
    return ThreadPoolExecutor(threads, thread_name_prefix="kernels") if threads > 1 else None
