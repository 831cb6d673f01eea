"""A scheduler of Dask and its workers, each in a process of its own."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from clusters import preload

HELPERS = Path(__file__).parents[1]


class DaskProcesses:
    """A scheduler, and workers with one thread and a nanny each."""

    def __init__(self, folder):
        self._file, self._processes = folder / "scheduler.json", []
        self._log = (folder / "log").open("wb")
        self.scheduler = self._start("scheduler", "--port", "0", "--dashboard-address", ":0")

    @property
    def address(self):
        while True:
            # The scheduler creates the file before it fills it.
            with suppress(FileNotFoundError, json.JSONDecodeError):
                return json.loads(self._file.read_text())["address"]
            assert self.scheduler.poll() is None
            time.sleep(0.02)

    def add_worker(self, path=()):
        """Start a worker; folders of the path come before those of this process."""
        return self._start("worker", "--nthreads", "1", "--no-dashboard", path=path)

    def _start(self, *command, path=()):
        follow = "--preload-nanny" if command[0] == "worker" else "--preload"
        path = os.pathsep.join([*path, str(HELPERS), os.environ.get("PYTHONPATH", "")])
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *command, "--host", "127.0.0.1",
             "--scheduler-file", str(self._file), follow, preload.__name__],
            env={
                **os.environ,
                "PYTHONPATH": path,
                preload.PARENT: str(os.getpid()),
                "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            },
            stdout=self._log, stderr=self._log, start_new_session=True,
        )  # fmt: skip
        self._processes.append(process)
        return process

    def end(self):
        for process in self._processes:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        self._log.close()
