"""Threads that run compiled kernels beside the calling thread."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
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


def begin(function: Callable[[], T]) -> Callable[[], T]:
    """Begin a function on another thread, and return one that gives its result.

    If no thread has begun it by then, as others' work was handed in before, it is called there.
    """
    pool = workers()
    if pool is None:
        return function
    task = pool.submit(function)
    return lambda: function() if task.cancel() else task.result()


def by_parts(function: Callable[[slice], T], count: int) -> list[T]:
    """Call a function with successive parts of a range, on as many threads as there are.

    The parts do not depend on the number of threads.
    """
    ends = [count * part // _PARTS for part in range(_PARTS + 1)]
    parts = [slice(*each) for each in pairwise(ends) if each[0] < each[1]]
    tasks = [begin(partial(function, part)) for part in parts]
    # The last ones first, as this thread can take those that no other one has begun.
    return [task() for task in tasks[::-1]][::-1]
