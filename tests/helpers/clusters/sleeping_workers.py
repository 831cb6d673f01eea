"""Many workers of Dask in one process: ``python -m clusters.sleeping_workers SCHEDULER NUMBER``."""

import asyncio
import pickle
import sys
import time

from distributed import Worker

from sonoservo.diagrams.studies import Outcome
from sonoservo.diagrams.studies.study import Finished


def sleep(message):
    """Stand in for `run_case`, without a process for each case."""
    case = pickle.loads(message)[2]
    time.sleep(case.settings["seconds"])
    return Finished(Outcome(case, {"figures": [0.0] * 100}))


def unused(case):
    """Never called: the cases sleep."""
    raise AssertionError


async def main(scheduler, number):
    settings = {"nthreads": 1, "dashboard": False, "memory_limit": 0, "host": "127.0.0.1"}
    await asyncio.gather(*(Worker(scheduler, **settings) for _ in range(number)))
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
