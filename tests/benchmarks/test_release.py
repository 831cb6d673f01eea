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
NAMES = (
    "loop of fig. 5, wall",
    "loop of fig. 5, processor",
    "rendering, probe moves",
    "rendering, probe still",
    "conversion of 44 Mvoxel",
    "conversion of 44 Mvoxel, motion compensated",
)


def measured(path):
    """Milliseconds by name, measured with the package in a folder, or with the one installed."""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("NUM_THREADS")}
    environment.pop("OMP_WAIT_POLICY", None)
    if path is not None:
        environment["PYTHONPATH"] = str(path.absolute())
    ran = subprocess.run(
        [sys.executable, str(PROGRAM)], env=environment, stdout=subprocess.PIPE, check=True
    )
    return json.loads(ran.stdout)


@pytest.fixture(scope="module")
def both():
    """Figures of this version and of the release."""
    package = FOLDER / "sonoservo"
    if not package.exists():
        packed = subprocess.run(["git", "archive", RELEASE], capture_output=True, check=False)
        if packed.returncode:
            pytest.skip("no history with version 0.2.0")
        with tarfile.open(fileobj=BytesIO(packed.stdout)) as archive:
            archive.extractall(package, filter="data")
    return measured(None), measured(FOLDER)


@pytest.mark.slow
@pytest.mark.bench
@pytest.mark.parametrize("name", NAMES)
def test_beside_the_release(benchmark, both, name):
    ours, released = both
    benchmark.pedantic(lambda: None, rounds=1)
    assert ours[name] > 0
    benchmark.extra_info.update(
        ms=ours[name], compared_with="0.2.0", alternative_ms=released[name],
        ratio=released[name] / ours[name],
    )  # fmt: skip
