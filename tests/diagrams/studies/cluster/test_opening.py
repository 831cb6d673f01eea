"""Clusters named by a text: addresses, numbers and files of job queues, right and wrong."""

import os
import sys

import pytest
from clusters.cases import calculate
from clusters.processes import HELPERS

from sonoservo.diagrams.studies import Case, open_cluster, run_cases
from sonoservo.diagrams.studies.cluster.opening import read_job_queue
from sonoservo.systems.files.refusals import ConfigurationError

SLURM = """
class: SLURMCluster
jobs: 20
arguments:
  cores: 8
  memory: 16GB
  queue: normal
  walltime: "02:00:00"
  job_extra_directives: ["--exclusive"]
"""


@pytest.mark.parametrize(
    ("text", "limit", "message"),
    [
        ("local:1", 0, "case limit: 0"),
        ("local:0", 60, "local:0: '0' is not allowed; it must be a number from 1 to 1024"),
        ("here", 60, "'here' is not allowed; it must be tcp://HOST:PORT, local:N or FILE.yaml"),
        ("ssh://", 60, "'ssh://' is not allowed; it must be tcp://HOST:PORT"),
        ("missing.yaml", 60, "missing.yaml: cannot be read"),
    ],
)
def test_a_wrong_text_or_limit_is_refused(text, limit, message):
    with pytest.raises(ConfigurationError, match=message), open_cluster(text, limit=limit):
        pass


@pytest.mark.parametrize("package", ["distributed", "dask_jobqueue", "cloudpickle"])
def test_one_line_says_what_to_install(package, monkeypatch, tmp_path):
    for name in [*sys.modules]:
        if name.startswith("sonoservo.diagrams.studies.cluster"):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / "slurm.yaml").write_text(SLURM)
    with (
        pytest.raises(ValueError, match=r"pip install -e '\.\[cluster\]'") as error,
        open_cluster(str(tmp_path / "slurm.yaml")),
    ):
        pass
    assert "\n" not in str(error.value)


def test_a_job_queue_is_read(tmp_path):
    (tmp_path / "slurm.yaml").write_text(SLURM)
    job_queue = read_job_queue(tmp_path / "slurm.yaml")
    assert job_queue.kind.__name__ == "SLURMCluster"
    assert job_queue.jobs == 20
    script = job_queue.kind(**job_queue.arguments, scheduler_options={"port": 0}).job_script()
    for line in ("-p normal", "--exclusive", "-t 02:00:00", "--cpus-per-task=8"):
        assert line in script


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("class: SlurmCluster", "class: 'SlurmCluster' is not allowed; "),
        ("jobs: 0", "jobs: 0 is not allowed; expected 1 or more"),
        ("workers: 3", "workers: unknown field; known: arguments, class, jobs"),
        ("arguments: {core: 3}", "arguments.core: unknown argument of SLURMCluster; did you mean"),
        ("arguments: {cores: two}", "arguments.cores: 'two' is not allowed; expected a whole"),
        ("arguments: {memory: 4}", "arguments.memory: 4 is not allowed; expected text"),
        ("arguments: {job_extra_directives: -x}", "expected a list of lines of text"),
    ],
)
def test_wrong_fields_of_a_job_queue_are_named(line, message, tmp_path):
    path = tmp_path / "queue.yaml"
    name = line.split(":")[0]
    lines = [each for each in ("class: SLURMCluster", "jobs: 2") if not each.startswith(name)]
    path.write_text("\n".join([*lines, line]))
    with pytest.raises(ConfigurationError, match=message) as error:
        read_job_queue(path)
    assert str(error.value).startswith(str(path))


@pytest.mark.slow
def test_jobs_of_a_queue_run_cases(tmp_path, monkeypatch):
    """With dask-jobqueue's class for trials, which starts its jobs on this machine."""
    path = [str(HELPERS), os.environ.get("PYTHONPATH", "")]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    path = tmp_path / "queue.yaml"
    path.write_text("class: LocalCluster\njobs: 2\narguments: {cores: 1, memory: 1GB}\n")
    cases = [Case("e", seed) for seed in range(8)]
    with open_cluster(str(path)) as cluster:
        outcomes = run_cases(calculate, cases, tmp_path / "out", cluster=cluster)
    assert all(outcomes)
