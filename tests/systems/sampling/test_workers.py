"""Threads for kernels: what is asked for is done, whoever is busy."""

import os
import threading

from sonoservo.systems.sampling.workers import begin, by_parts


def test_parts_are_done_in_order_while_all_threads_are_busy():
    released = threading.Event()
    busy = [begin(lambda: released.wait(60)) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        for count in (0, 1, 3, 10):
            parts = by_parts(lambda part: list(range(part.start, part.stop)), count)
            assert [number for part in parts for number in part] == list(range(count))
    finally:
        released.set()
    assert all(task() for task in busy)
