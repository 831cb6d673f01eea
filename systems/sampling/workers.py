"""Threads that run compiled kernels beside the calling thread."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import TypeVar

from joblib import cpu_count
from numba import config

T = TypeVar("T")

_PARTS = 4


@cache
def workers() -> ThreadPoolExecutor | None:
    """Return the threads for kernels, one per core; None if there is only one.

    The cores are those that this process may use, by its affinity, its container's share and
    Numba's setting. Kernels release the GIL, so they also run beside Drake and Python. A task must
    not wait for another one.
    """
    threads = min(int(config.NUMBA_NUM_THREADS), cpu_count())
    return ThreadPoolExecutor(threads, thread_name_prefix="kernels") if threads > 1 else None


def by_parts(function: Callable[[slice], T], count: int) -> list[T]:
    """Call a function with successive parts of a range, on as many threads as there are.

    The parts do not depend on the number of threads. The calling thread does those that no other
    one has begun, so it does not wait for a scanner's frames that were handed in before.
    """
    ends = [count * part // _PARTS for part in range(_PARTS + 1)]
    parts = [slice(*each) for each in pairwise(ends) if each[0] < each[1]]
    pool = workers()
    if pool is None:
        return list(map(function, parts))
    begun = [(pool.submit(function, part), part) for part in parts]
    last_first = [task.result() if not task.cancel() else function(part) for task, part in begun[::-1]]
    return last_first[::-1]
