import os
import subprocess
import sys

import pytest
from commands import sonoservo

from sonoservo.diagrams import track
from sonoservo.diagrams.app.compile import _volumes

RUN = """
import sys
from numba.core import event
from sonoservo.diagrams.app.__main__ import main

class Compiled(event.Listener):
    def on_start(self, e):
        print("compiled", e.data["dispatcher"].py_func.__name__)
    def on_end(self, e):
        pass

event.register("numba:compile", Compiled())
main()
"""


def test_the_volumes_to_compile_with_show_a_needle():
    """Otherwise the localizer is never called."""
    assert "tracking" in [str(estimate.mode) for estimate in track(_volumes())]


@pytest.mark.slow
def test_nothing_is_left_to_compile_for_a_run(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert sonoservo("compile").returncode == 0
    changes = ["duration=8", "hand.start=1", "hand.pushes.0.speed=0.016"]
    arguments = [each for change in changes for each in ("--set", change)]
    out = ["--no-meshcat", "--out", str(tmp_path / "out")]
    run = [sys.executable, "-c", RUN, "run", "chatelain2013_fig5", *arguments, *out]
    result = subprocess.run(run, capture_output=True, text=True, check=True, env=dict(os.environ))
    assert "tracking" in (tmp_path / "out" / "summary.json").read_text()
    assert "compiled" not in result.stdout
