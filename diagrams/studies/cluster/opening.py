"""Clusters by a text: address of a scheduler, processes of this machine, or file of a job queue."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from sonoservo.systems.files.refusals import ConfigurationError, describe

if TYPE_CHECKING:
    from sonoservo.diagrams.studies.cluster.cluster import Cluster

CASE_LIMIT_S = 3600.0  # longest time in s that a case may take, unless another one is given

_LOCAL = "local:"
_CONNECT_S = 15.0


@contextmanager
def open_cluster(
    text: str,
    *,
    limit: float = CASE_LIMIT_S,
    notify: Callable[[str], None] = print,
) -> Iterator["Cluster"]:
    """Open a cluster of Dask distributed for the cases of studies.

    Parameters
    ----------
    text
        ``tcp://host:8786``, the address of a scheduler; ``local:4``, so many processes
        of this machine; or the path of a YAML file that names a class of dask-jobqueue
        (`read_job_queue`).
    limit
        Longest time in s that a case may take.
    notify
        Function that shows a line of text, such as the address of the dashboard.

    Yields
    ------
    The cluster, for `run_cases`. Workers that were started for it end with the block.

    Raises
    ------
    ConfigurationError
        If Dask is missing, the text has another form, the file is wrong, or no scheduler answers.
    """
    if not limit > 0:
        raise ConfigurationError(f"case limit: {limit:g} is not allowed; it must be above 0 s")
    try:
        from distributed import Client

        from sonoservo.diagrams.studies.cluster.cluster import Cluster
    except ImportError as error:
        raise ConfigurationError(
            f"cluster: {text}: install Dask first: pip install -e '.[cluster]' ({error.name})"
        ) from error
    # What Dask logs about lost connections is said in one line by this program.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    with _scheduler(text) as scheduler:
        try:
            client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigurationError(
                f"cluster: {text}: no scheduler answers: {describe(error)}"
            ) from error
        with client:
            cluster = Cluster(client, limit=limit)
            notify(f"Dashboard of the cluster: {cluster.dashboard}")
            yield cluster


@contextmanager
def _scheduler(text: str) -> Iterator[object]:
    """Yield the address of a scheduler, or one of Dask's own clusters."""
    if "://" in text:
        yield text
    elif text.startswith(_LOCAL):
        from sonoservo.diagrams.studies.cluster.local_cluster import local_cluster

        count = text.removeprefix(_LOCAL)
        if not count.isdecimal() or not 1 <= int(count) <= 1024:
            raise ConfigurationError(
                f"cluster: {text}: {count!r} is not allowed; it must be a number from 1 to 1024"
            )
        with local_cluster(int(count)) as cluster:
            yield cluster
    elif text.endswith((".yaml", ".yml")):
        from sonoservo.diagrams.studies.cluster.job_queue import read_job_queue

        with read_job_queue(Path(text)).start() as cluster:
            yield cluster
    else:
        raise ConfigurationError(
            f"cluster: {text!r} is not allowed; it must be tcp://HOST:PORT, local:N or FILE.yaml"
        )
