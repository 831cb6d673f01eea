"""Cases on a real scheduler and real workers, which are killed, hang, differ or disappear.

The tests share a cluster, and each leaves it with two workers.
"""

import hashlib
import os
import shutil
import signal
import threading
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest
from clusters.cases import calculate, count, end_process, wait_once
from clusters.processes import DaskProcesses
from distributed import Client
from live_items import wait_until

from sonoservo.diagrams.studies import Case, Store, open_cluster, run_cases
from sonoservo.diagrams.studies.cluster.cluster import Cluster
from sonoservo.systems.files.refusals import ConfigurationError


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    processes = DaskProcesses(tmp_path_factory.mktemp("dask"))
    for _ in range(2):
        processes.add_worker()
    yield processes
    processes.end()


@pytest.fixture(scope="module")
def client(processes):
    with Client(processes.address, timeout=60, set_as_default=False) as client:
        yield client


@pytest.fixture
def cluster(client):
    client.wait_for_workers(2, timeout=60)
    return Cluster(client, limit=60)


def without_time(outcomes):
    return [replace(each, wall_s=0.0) for each in outcomes]


def cases(number, folder=None, **settings):
    folder = {} if folder is None else {"folder": str(folder)}
    return [Case("e", seed, {**folder, **settings}) for seed in range(number)]


def reported(folder):
    """Return the numbers of the workers' processes that reported, and of their nannies."""
    return [tuple(map(int, path.read_text().split())) for path in folder.glob("[0-9]*")]


def lives(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


class Notes(list):
    """Console that keeps what it is told."""

    def __init__(self, cluster):
        self._run, cluster.run = cluster.run, self._noting_run

    def _noting_run(self, work, cases, store, notify):
        return self._run(work, cases, store, self.append)


@pytest.mark.slow
def test_outcomes_and_files_are_those_of_this_machine(cluster, tmp_path):
    wanted = run_cases(calculate, cases(12, raises=3), tmp_path / "here")
    found = run_cases(calculate, cases(12, raises=3), tmp_path / "there", cluster=cluster)
    assert without_time(found) == without_time(wanted)
    assert found[3].error == "ValueError: no luck"
    assert found[0].result["threads"] == ["1"]
    for name, file in found[0].files.items():
        data = (tmp_path / "there" / name).read_bytes()
        assert data == (tmp_path / "here" / name).read_bytes()
        assert hashlib.sha256(data).hexdigest() == file["sha256"]
    assert all(each.wall_s > 0 for each in found)
    # What one of them has kept, the other one does not do again.
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "there").glob("*.json")}
    run_cases(calculate, cases(12, raises=3), tmp_path / "there", jobs=1)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept


def test_workers_write_into_a_shared_store(cluster, tmp_path):
    store = Store((tmp_path / "store").as_uri(), shared=True)
    outcomes = run_cases(calculate, cases(3), tmp_path / "out", cluster=cluster, store=store)
    sizes = {name: file["bytes"] for each in outcomes for name, file in each.files.items()}
    assert store.sizes() == sizes
    assert not list((tmp_path / "out").rglob("*.bin"))


def test_a_case_that_ends_its_worker_is_a_failure_and_its_neighbours_are_none(cluster, tmp_path):
    seen = tmp_path / "seen"
    seen.mkdir()
    poison = Case("e", 9, {"folder": str(seen), "poison": True})
    mixed = [poison, *cases(4, seen)]
    outcomes = run_cases(end_process, mixed, tmp_path / "out", cluster=cluster)
    assert [each.error for each in outcomes] == ["its process died", "", "", "", ""]
    assert len(list(seen.glob("9_*"))) == 2  # the first time and once again
    run_cases(end_process, mixed, tmp_path / "out", cluster=cluster)
    assert len(list(seen.glob("9_*"))) == 2


@pytest.mark.slow
def test_a_case_that_takes_too_long_runs_again_and_leaves_nothing(client, tmp_path):
    client.wait_for_workers(2, timeout=60)
    cluster = Cluster(client, limit=1)
    outcomes = run_cases(wait_once, cases(1, tmp_path), tmp_path / "out", cluster=cluster)
    assert [each.result for each in outcomes] == [{"attempt": 2}]
    wait_until(lambda: sum(lives(process) for process, _ in reported(tmp_path)) <= 1, 10)


@pytest.mark.slow
def test_workers_make_way_for_others_after_ten_cases(cluster, tmp_path):
    assert all(run_cases(count, cases(30, tmp_path), tmp_path / "out", cluster=cluster))
    workers = {process for process, _ in reported(tmp_path)}
    wait_until(lambda: not all(lives(process) for process in workers))


@pytest.mark.slow
def test_ctrl_c_leaves_no_case_running(cluster, tmp_path):
    def interrupt():
        wait_until(lambda: len(reported(tmp_path)) == 2)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        run_cases(wait_once, cases(5, tmp_path), tmp_path / "out", cluster=cluster)
    wait_until(lambda: not any(lives(process) for process, _ in reported(tmp_path)), 20)


@pytest.mark.slow
def test_a_worker_with_another_package_gets_no_cases(processes, client, tmp_path):
    package = tmp_path / "sonoservo"
    for part in ("systems", "models"):
        package.mkdir(exist_ok=True)
        (package / part).symlink_to(Path(str(files(f"sonoservo.{part}"))))
    shutil.copytree(Path(str(files("sonoservo.diagrams"))), package / "diagrams")
    with (package / "diagrams" / "seeds.py").open("a") as module:
        module.write("# another version\n")
    other = processes.add_worker([str(tmp_path)])
    client.wait_for_workers(3, timeout=60)
    notes = Notes(cluster := Cluster(client, limit=60))
    outcomes = run_cases(count, cases(6, tmp_path), tmp_path / "out", cluster=cluster)
    assert all(outcomes)
    assert other.pid not in {nanny for _, nanny in reported(tmp_path)}
    (line,) = notes
    assert line.startswith("tcp://")
    assert "sonoservo's code" in line
    assert " instead of " in line
    other.kill()


def test_work_that_no_worker_can_load_is_refused(cluster, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("def work(case):\n    return {}\n")
    monkeypatch.syspath_prepend(tmp_path)
    from mine import work

    with pytest.raises(ConfigurationError, match="no worker can run the cases.*'mine'"):
        run_cases(work, cases(1), tmp_path / "out", cluster=cluster)


@pytest.mark.slow
def test_after_the_scheduler_s_death_the_rest_is_done_elsewhere(processes, client, tmp_path):
    """The last test: the shared cluster is gone after it."""
    seen, out = tmp_path / "seen", tmp_path / "out"
    seen.mkdir()
    (seen / "wait").touch()

    def kill():
        wait_until(lambda: len(list(out.glob("*.json"))) == 1 and len(reported(seen)) == 2)
        processes.scheduler.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    cluster = Cluster(client, limit=60, patience=1)
    with pytest.raises(ConnectionError, match="scheduler is gone; finished cases are kept"):
        run_cases(count, cases(2, seen), out, cluster=cluster)
    killer.join()
    (seen / "wait").unlink()
    notes = []
    with open_cluster("local:1", notify=notes.append) as cluster:
        outcomes = run_cases(count, cases(2, seen), out, cluster=cluster)
    assert [each.result["seed"] for each in outcomes] == [0, 1]
    assert len(list(seen.glob("0_*"))) == 1
    assert "http://127.0.0.1" in notes[0]
    wait_until(lambda: not any(lives(process) for process, _ in reported(seen)), 10)
