"""Settings of NumPy's libraries, as the program's first import leaves them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SET = (
    "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "OMP_WAIT_POLICY",
    "OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES",
)  # fmt: skip
ASK = f"import os, sys; print('numpy' in sys.modules, *map(os.environ.get, {SET}), sep=';')"
CPU = Path("/proc/cpuinfo")
WIDE = CPU.exists() and "avx512f" in CPU.read_text()
OURS = ["Haswell", "X86_V4 AVX512F AVX512CD AVX512_SKX AVX512_ICL AVX512_SPR"]


DEFAULT = ["1", "None", "passive", *(OURS if WIDE else ["None", "None"])]


@pytest.mark.parametrize(
    ("package", "own", "expected"),
    [
        ("systems", {}, DEFAULT),
        ("diagrams", {}, DEFAULT),
        ("systems", {"OMP_NUM_THREADS": "4"}, ["None", "4", "passive"]),
        (
            "systems",
            {name: "3" for name in SET if name != "OMP_NUM_THREADS"},
            ["3", "None", "3", "3", "3"],
        ),
    ],
)
def test_the_first_import_sets_what_the_user_has_not(package, own, expected):
    environment = {k: v for k, v in os.environ.items() if k not in SET} | own
    command = [sys.executable, "-c", f"import sonoservo.{package}; {ASK}"]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    numpy_was_loaded, *settings = ran.stdout.strip().split(";")
    assert numpy_was_loaded == "False"
    assert settings[: len(expected)] == expected
