"""Cluster on this machine: a scheduler and a worker, each in a process of its own."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from sonoservo.diagrams.studies.cluster import preload
from sonoservo.systems.files.refusals import ConfigurationError

_START_S = 60.0

_CALM = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "5s",
    "DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING": "False",
}
"""Settings with which Dask's idle processes leave the cores to the cases; the user's go first."""


@contextmanager
def local_cluster(cases: int) -> Iterator[str]:
    """Start a scheduler and a worker, which end with the block or with this process.

    The worker finds modules where this process does.

    Parameters
    ----------
    cases
        Number of cases to run at the same time; each has a process of its own.

    Yields
    ------
    Address of the scheduler.
    """
    with TemporaryDirectory(prefix="sonoservo_cluster_") as name:
        folder = Path(name)
        file, log = folder / "scheduler.json", folder / "log"
        shared = ["--scheduler-file", str(file), "--host", "127.0.0.1"]
        commands = (
            f"scheduler --port 0 --dashboard-address 127.0.0.1:0 --preload {preload.__name__}",
            f"worker --nworkers 1 --nthreads {cases} --no-dashboard --memory-limit 0"
            f" --preload-nanny {preload.__name__}",
        )
        environment = {
            **_CALM,
            **os.environ,
            preload.PARENT: str(os.getpid()),
            "PYTHONPATH": os.pathsep.join(sys.path),
        }
        processes = []
        try:
            with log.open("wb") as output:
                for command in commands:
                    processes.append(
                        subprocess.Popen(
                            [sys.executable, "-m", "dask", *command.split(), *shared],
                            stdin=subprocess.DEVNULL,
                            stdout=output,
                            stderr=output,
                            env=environment,
                            start_new_session=True,  # Ctrl-C is for this process alone
                        )
                    )
            yield _address(file, processes[0], log)
        finally:
            for process in processes:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _address(file: Path, scheduler: subprocess.Popen[bytes], log: Path) -> str:
    deadline = time.monotonic() + _START_S
    while scheduler.poll() is None and time.monotonic() < deadline:
        try:
            return str(json.loads(file.read_text())["address"])
        except (OSError, ValueError):
            time.sleep(0.02)
    lines = log.read_text(errors="replace").splitlines()
    raise ConfigurationError(f"cluster: its scheduler does not start: {lines[-1:]}")
