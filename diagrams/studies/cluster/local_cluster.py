"""Cluster on this machine: a scheduler and a worker in threads of this process."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import dask
from distributed import LocalCluster

_CALM = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.low-level-log-length": 100,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.scheduler.work-stealing": False,
}
"""Settings with which Dask leaves cores and memory to the cases."""


@contextmanager
def local_cluster(cases: int) -> Iterator[LocalCluster]:
    """Start a scheduler and a worker, which end with the block.

    The worker only waits for its cases, whose processes end with this one. A process for each would
    cost more than a second of processor.
    """
    with (
        dask.config.set(_CALM),
        LocalCluster(
            n_workers=1,
            threads_per_worker=cases,
            processes=False,
            protocol="tcp",
            host="127.0.0.1",
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL + 1,
        ) as cluster,
    ):
        yield cluster
