"""The loop and its parts beside version 0.2.0, each in a process as a user starts it."""

import json
import os
import subprocess
import sys
import tarfile
from io import BytesIO
from pathlib import Path

import pytest

RELEASE = "ba88d58"
"""Commit of version 0.2.0."""
FOLDER = Path("out/release_0.2.0")
PROGRAM = Path(__file__).with_name("parts_of_a_loop.py")
LOOP = (
    "a volume in the loop, wall",
    "a volume in the loop, processor",
    "rendering in the loop",
    "tracking, median",
    "tracking, slowest",
)
NAMES = (
    "start of the program to the first volume",
    *(f"{scenario}: {each}" for scenario in ("chatelain2013_fig5", "clinic") for each in LOOP),
)

pytestmark = [pytest.mark.slow, pytest.mark.bench]


def measured(*arguments, **variables):
    """Milliseconds by name, measured in a process without limits but the variables given."""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("NUM_THREADS")}
    environment.pop("OMP_WAIT_POLICY", None)
    command = [sys.executable, str(PROGRAM), *arguments]
    ran = subprocess.run(command, env=environment | variables, stdout=subprocess.PIPE, check=True)
    return json.loads(ran.stdout)


@pytest.fixture(scope="module")
def ours():
    return measured()


@pytest.fixture(scope="module")
def release():
    package = FOLDER / "sonoservo"
    if not package.exists():
        packed = subprocess.run(["git", "archive", RELEASE], capture_output=True, check=False)
        if packed.returncode:
            pytest.skip("no history with version 0.2.0")
        with tarfile.open(fileobj=BytesIO(packed.stdout)) as archive:
            archive.extractall(package, filter="data")
        measured(PYTHONPATH=str(FOLDER.absolute()))  # compiles the kernels
    return measured(PYTHONPATH=str(FOLDER.absolute()))


@pytest.mark.parametrize("name", NAMES)
def test_beside_the_release(benchmark, ours, release, name):
    benchmark.pedantic(lambda: None, rounds=1)
    assert ours[name] > 0
    benchmark.extra_info.update(
        ms=ours[name], compared_with="0.2.0", ratio=release[name] / ours[name]
    )


def test_threads_cost_no_processor_time(benchmark, ours):
    """A single thread never waits for another one, so it takes what the parts need."""
    needed = measured("loop", OMP_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    benchmark.pedantic(lambda: None, rounds=1)
    name = f"chatelain2013_fig5: {LOOP[1]}"
    benchmark.extra_info.update(
        ms=ours[name], compared_with="one thread", ratio=needed[name] / ours[name]
    )
    assert ours[name] <= 1.15 * needed[name]
