"""Cluster on this machine: a scheduler in this process, and workers in processes of their own."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import dask
from distributed import LocalCluster

from sonoservo.diagrams.studies.processes import THREADS, keeping_ctrl_c

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
    """Start a scheduler and a worker for each of so many cases; they end with the block."""
    with dask.config.set(_CALM), keeping_ctrl_c():
        cluster = LocalCluster(
            n_workers=cases,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL + 1,
            env=dict.fromkeys(THREADS, "1"),
        )
    with dask.config.set(_CALM), cluster:
        yield cluster
