"""What the displays cost a run, and the thread that draws the scanner's monitor."""

import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from meshcat import Visualizer
from pydrake.geometry import Meshcat, MeshcatParams
from synthetic_volumes import Scene, entry_on_side

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.experiment import Experiment
from sonoservo.systems.display.monitor import Monitor
from sonoservo.systems.display.monitor_screen import MonitorScreen
from sonoservo.systems.estimation.estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.needle.curve import NeedleCurve

ENTRY = entry_on_side()
TIP = ENTRY + np.array([0.045, 0.012, 0.005])
PERIOD = 0.303
"""Of the volumes of fig. 5, in s."""


class Nowhere:
    def send(self, command):
        command.lower()


@pytest.fixture(scope="module")
def shown():
    volume = Scene(seed=5).volume(2, lambda time: (ENTRY, TIP))
    curve = NeedleCurve([ENTRY, TIP])
    return volume, NeedleEstimate(
        TrackingMode.TRACKING, volume.time, curve, np.zeros((2, 3)), np.eye(12), volume.time
    )


def compare(benchmark):
    benchmark.extra_info["compared_with"] = "real time: 303 ms a volume"
    if benchmark.stats is not None:
        benchmark.extra_info["ratio"] = PERIOD / benchmark.stats.stats.median


def test_showing_a_volume(benchmark, shown):
    """On the run's thread."""
    monitor = Monitor()
    benchmark(lambda: monitor.show(*shown))
    monitor.close()
    compare(benchmark)


def test_drawing_a_volume(benchmark, shown):
    """On the monitor's thread, for any number of pages."""
    screen = MonitorScreen(Visualizer(window=Nowhere()))
    number = 0

    def draw():
        nonlocal number
        number += 1
        screen.draw(*shown, number)

    benchmark(draw)
    compare(benchmark)


PAGE = """
import base64, os, socket, sys
host, port = sys.argv[1].removeprefix("ws://").split(":")
page = socket.create_connection((host, int(port)))
key = base64.b64encode(os.urandom(16)).decode()
lines = ["GET / HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade",
         f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", ""]
page.sendall("\\r\\n".join(lines).encode())
while page.recv(1 << 20):
    pass
"""


@contextmanager
def page_that_draws_nothing(meshcat):
    """A process that fetches all a page would: a browser without a graphics chip eats a core."""
    process = subprocess.Popen([sys.executable, "-c", PAGE, meshcat.ws_url()])
    try:
        while not meshcat.GetNumActiveConnections():
            assert process.poll() is None
            time.sleep(0.05)
        yield
    finally:
        process.kill()
        process.wait()


def run_once(scenario, meshcat=None):
    """Wall-clock time in s of a run, not held to real time."""
    if meshcat is not None:
        meshcat.DeleteRecording()
        meshcat.StartRecording(set_visualizations_while_recording=True)
    experiment = Experiment(scenario, meshcat)
    start = time.perf_counter()
    experiment.run()
    return time.perf_counter() - start


@pytest.mark.parametrize("watched", [False, True], ids=["no browser", "a page"])
def test_a_run_with_the_world_view(benchmark, watched):
    """With the film for the replay; without a display it is timed in between."""
    enabled = benchmark.enabled
    scenario = load_scenario("chatelain2013_fig5", changes=[f"duration={16 if enabled else 1}"])
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    plain, shown = [], []

    def both():
        plain.append(run_once(scenario))
        shown.append(run_once(scenario, meshcat))

    both()
    if watched:
        with page_that_draws_nothing(meshcat):
            benchmark.pedantic(both, rounds=3 if enabled else 1)
    else:
        benchmark.pedantic(both, rounds=3 if enabled else 1)
    benchmark.extra_info["compared_with"] = "the same run without a display"
    benchmark.extra_info["ratio"] = min(plain[1:]) / min(shown[1:])
