"""Cost of a cluster: overhead against joblib, load of scheduler and client, memory of many runs."""

import os
import subprocess
import sys
import time
from contextlib import contextmanager

import psutil
import pytest
from clusters.cases import run_short
from clusters.processes import HELPERS, DaskProcesses
from clusters.sleeping_workers import sleep, unused
from distributed import Client

from sonoservo.diagrams.studies.cluster.cluster import Cluster
from sonoservo.diagrams.studies.cluster.opening import open_cluster
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.study import Case

WORKERS = int(os.environ.get("BENCH_WORKERS", "250"))
SECONDS = float(os.environ.get("BENCH_SECONDS", "15"))
RUNS = int(os.environ.get("BENCH_RUNS", "40"))

pytestmark = [pytest.mark.slow, pytest.mark.benchmark(min_rounds=1)]


class SleepingCluster(Cluster):
    """Cluster whose cases sleep."""

    def _submit(self, message, worker, key):
        return self._client.submit(
            sleep, message, key=key, workers=[worker], allow_other_workers=False, pure=False
        )


def used(process):
    times = process.cpu_times()
    return times.user + times.system


@contextmanager
def scheduler_with_workers(folder, number, hosts=4):
    processes = DaskProcesses(folder)
    address = processes.address
    started = [
        subprocess.Popen(
            [sys.executable, "-m", "clusters.sleeping_workers", address, str(number // hosts)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": f"{HELPERS}:{os.environ.get('PYTHONPATH', '')}"},
        )
        for _ in range(hosts)
    ]
    try:
        yield processes, address
    finally:
        for each in started:
            each.kill()
            each.wait()
        processes.end()


def test_load_of_scheduler_and_client(benchmark, tmp_path):
    """Processor time a case of 15 s, from which the largest number of workers follows."""
    figures = benchmark.extra_info
    (tmp_path / "dask").mkdir()
    with scheduler_with_workers(tmp_path / "dask", WORKERS) as (processes, address):
        scheduler, me = psutil.Process(processes.scheduler.pid), psutil.Process()
        with Client(address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(WORKERS, timeout=300)
            rest = used(scheduler), time.monotonic()
            time.sleep(10)
            idle = (used(scheduler) - rest[0]) / (time.monotonic() - rest[1])
            cases = [Case("e", k, {"seconds": SECONDS}) for k in range(3 * WORKERS)]
            before = used(scheduler), used(me), time.monotonic(), me.memory_info().rss
            cluster = SleepingCluster(client, limit=600)
            outcomes = benchmark.pedantic(
                lambda: run_cases(unused, cases, tmp_path / "out", cluster=cluster), rounds=1
            )
            wall = time.monotonic() - before[2]
            figures["workers"] = WORKERS
            figures["cases_per_s"] = len(cases) / wall
            figures["of_ideal"] = 3 * SECONDS / wall
            figures["scheduler_idle_share"] = idle
            figures["scheduler_ms_per_case"] = 1e3 * (used(scheduler) - before[0]) / len(cases)
            figures["client_ms_per_case"] = 1e3 * (used(me) - before[1]) / len(cases)
            figures["client_grows_mb"] = (me.memory_info().rss - before[3]) / 1e6
            figures["scheduler_mb"] = scheduler.memory_info().rss / 1e6
    print(dict(figures))
    assert all(outcomes)


def test_overhead_against_joblib(benchmark, tmp_path):
    """The same real runs, in turn with joblib and on a cluster of two, start and end included."""
    walls = {"joblib": [], "cluster": []}
    cases = [Case("e", 100 + k, {"duration": 8.0}) for k in range(20)]

    def with_joblib(folder):
        return run_cases(run_short, cases, folder, jobs=2)

    def with_cluster(folder):
        with open_cluster("local:2") as cluster:
            return run_cases(run_short, cases, folder, cluster=cluster)

    with_joblib(tmp_path / "warm")
    for turn in range(3):
        for name, run in (("joblib", with_joblib), ("cluster", with_cluster)):
            began = time.perf_counter()
            assert all(run(tmp_path / f"{name}{turn}"))
            walls[name].append(time.perf_counter() - began)
    benchmark.pedantic(lambda: None, rounds=1)
    benchmark.extra_info.update(walls, ratio=min(walls["cluster"]) / min(walls["joblib"]))
    print(dict(benchmark.extra_info))


def test_memory_of_many_runs(benchmark, tmp_path):
    """Resident memory of the client, the workers and the cases during runs of 2 s."""
    rows = []
    cases = [Case("e", 100 + k, {"duration": 2.0}) for k in range(RUNS)]
    with open_cluster("local:2") as cluster:
        me = psutil.Process()

        class Watching:
            slots = cluster.slots

            def run(self, *arguments):
                for number, finished in enumerate(cluster.run(*arguments)):
                    if number % 10 == 0:
                        rows.append([number, *memory(me)])
                        print(rows[-1], flush=True)
                    yield finished

        outcomes = benchmark.pedantic(
            lambda: run_cases(run_short, cases, tmp_path, cluster=Watching()), rounds=1
        )
    assert all(outcomes)
    benchmark.extra_info["run, client, scheduler, nanny, worker, largest case in MB"] = rows


def memory(me):
    """Return resident memory in MB of this process, of Dask's and of the largest case."""
    own = {"scheduler": 0.0, "nanny": 0.0, "worker": 0.0, "case": 0.0}
    for process in me.children(recursive=True):
        try:
            line, size = " ".join(process.cmdline()), process.memory_info().rss / 1e6
        except psutil.NoSuchProcess:
            continue
        kinds = {"case_process": "case", "dask scheduler": "scheduler", "dask worker": "nanny"}
        key = next((kind for part, kind in kinds.items() if part in line), "worker")
        own[key] = max(own[key], size)
    return [round(me.memory_info().rss / 1e6), *(round(each) for each in own.values())]
