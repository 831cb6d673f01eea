"""Cost of a cluster: overhead against pool, load of scheduler and client, memory of many runs."""

import os
import resource
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import psutil
import pytest
from clusters.cases import run_short
from clusters.processes import HELPERS, DaskProcesses
from clusters.sleeping_workers import sleep, unused
from distributed import Client
from matplotlib.figure import Figure

from sonoservo.diagrams.studies import Case, open_cluster, run_cases
from sonoservo.diagrams.studies.cluster.cluster import Cluster

WORKERS = int(os.environ.get("BENCH_WORKERS", "250"))
SECONDS = float(os.environ.get("BENCH_SECONDS", "15"))
RUNS = int(os.environ.get("BENCH_RUNS", "40"))
TURNS = int(os.environ.get("BENCH_TURNS", "1"))
MEMORY_PICTURE = Path("out/cluster_memory.png")
PATH = f"{HELPERS}:{os.environ.get('PYTHONPATH', '')}"
RUN = ("pool", "cluster")
STUDY = """
import sys
from pathlib import Path

from clusters.cases import run_short

from sonoservo.diagrams.studies import Case, open_cluster, run_cases

name, folder = sys.argv[1:]
cases = [Case("e", 100 + k, {"duration": 4.0}) for k in range(24)]
if name == "pool":
    outcomes = run_cases(run_short, cases, Path(folder), jobs=2)
else:
    with open_cluster("local:2") as cluster:
        outcomes = run_cases(run_short, cases, Path(folder), cluster=cluster)
assert all(outcomes)
"""

pytestmark = [pytest.mark.slow, pytest.mark.benchmark(min_rounds=1)]


class SleepingCluster(Cluster):
    """Cluster whose cases sleep."""

    def _submit(self, message):
        return self._client.submit(sleep, message, pure=False)


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
            env={**os.environ, "PYTHONPATH": PATH},
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
            client.wait_for_workers(WORKERS, timeout=900)
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


def processor_time():
    """Return the processor time in s of this process and of all that ended below it."""
    usages = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def test_overhead_against_pool(benchmark, tmp_path):
    """The same real runs, in turn with pool and on a cluster of two, start and end included."""
    figures = {f"{name}_{kind}_s": [] for name in RUN for kind in ("wall", "processor")}
    for turn in range(TURNS):
        for name in RUN:
            began, before = time.perf_counter(), processor_time()
            command = [sys.executable, "-c", STUDY, name, str(tmp_path / f"{name}{turn}")]
            subprocess.run(command, check=True, env={**os.environ, "PYTHONPATH": PATH})
            figures[f"{name}_wall_s"].append(time.perf_counter() - began)
            figures[f"{name}_processor_s"].append(processor_time() - before)
    benchmark.pedantic(lambda: None, rounds=1)
    best = {name: min(values) for name, values in figures.items()}
    for kind in ("wall", "processor"):
        ratio = best[f"cluster_{kind}_s"] / best[f"pool_{kind}_s"]
        benchmark.extra_info[f"{kind}_ratio"] = ratio
    benchmark.extra_info.update(figures)
    print(dict(benchmark.extra_info))


def test_memory_of_many_runs(benchmark, tmp_path):
    """Resident memory of the client, with scheduler and worker, and of the largest case."""
    rows = []
    cases = [Case("e", 100 + k, {"duration": 2.0}) for k in range(RUNS)]
    with open_cluster("local:2") as cluster:
        me = psutil.Process()

        class Watching:
            slots = cluster.slots

            def run(self, *arguments):
                for number, finished in enumerate(cluster.run(*arguments), 1):
                    rows.append([number, *memory(me)])
                    if number % 10 == 0:
                        print(rows[-1], flush=True)
                    yield finished

        outcomes = benchmark.pedantic(
            lambda: run_cases(run_short, cases, tmp_path, cluster=Watching()), rounds=1
        )
    assert all(outcomes)
    benchmark.extra_info["runs, client and largest case in MB"] = rows
    draw_memory(np.array(rows))


def memory(me):
    """Return resident memory in MB of this process and of the largest case."""
    largest = 0.0
    for process in me.children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            largest = max(largest, process.memory_info().rss / 1e6)
    return me.memory_info().rss / 1e6, largest


def draw_memory(rows):
    figure = Figure(figsize=(8, 3.5), layout="constrained")
    axes = figure.subplots()
    for column, label in ((1, "client, scheduler and worker"), (2, "largest case")):
        axes.plot(rows[:, 0], rows[:, column], ".-", ms=3, lw=0.7, label=label)
    axes.set(xlabel="runs ended", ylabel="resident memory / MB", ylim=(0, None))
    axes.legend()
    axes.grid(alpha=0.3)
    MEMORY_PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(MEMORY_PICTURE, dpi=120)
