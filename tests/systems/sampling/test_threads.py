"""Threads of NumPy's libraries, as the program's first import leaves them."""

import os
import subprocess
import sys

import pytest

LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OMP_WAIT_POLICY")
ASK = f"import os, sys; print('numpy' in sys.modules, *map(os.environ.get, {LIMITS}))"


@pytest.mark.parametrize("package", ["systems", "diagrams"])
@pytest.mark.parametrize(
    ("own", "expected"),
    [
        ({}, "False 1 None passive"),
        ({"OPENBLAS_NUM_THREADS": "3", "OMP_WAIT_POLICY": "active"}, "False 3 None active"),
        ({"OMP_NUM_THREADS": "4"}, "False None 4 passive"),
    ],
)
def test_the_first_import_sets_what_the_user_has_not(package, own, expected):
    environment = {k: v for k, v in os.environ.items() if k not in LIMITS} | own
    command = [sys.executable, "-c", f"import sonoservo.{package}; {ASK}"]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == expected
