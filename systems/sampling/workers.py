"""Threads that run compiled kernels beside the calling thread."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

from numba import config


@cache
def workers() -> ThreadPoolExecutor | None:
    """Return the threads for kernels, as many as Numba may use; None if that is only one.

    Kernels release the GIL, so they also run beside Drake and Python. A task must not wait for
    another one.
    """
    threads = int(config.NUMBA_NUM_THREADS)
    return ThreadPoolExecutor(threads, thread_name_prefix="kernels") if threads > 1 else None
