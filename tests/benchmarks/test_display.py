"""What the displays cost a run, and the thread that draws the scanner's monitor."""

import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext

import numpy as np
import pytest
from meshcat import Visualizer
from synthetic_volumes import Scene, entry_on_side

from sonoservo.diagrams import load_scenario, make_experiment
from sonoservo.systems.display.monitor.drawing import MonitorScreen
from sonoservo.systems.display.monitor.monitor import Monitor
from sonoservo.systems.display.pages.meshcat_page import open_meshcat
from sonoservo.systems.display.pages.site import Site
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

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
import asyncio, sys
from urllib.parse import urlsplit
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

async def watch(url, answer):
    request = HTTPRequest(url, headers={"Origin": f"http://{urlsplit(url).netloc}"})
    page = await websocket_connect(request, max_message_size=1 << 30)
    print("open", flush=True)
    while await page.read_message() is not None:
        if answer:
            await page.write_message(answer)

asyncio.run(watch(*sys.argv[1:]))
"""


@contextmanager
def pages_that_draw_nothing(meshcat, monitor):
    """Processes that fetch all a page would: a browser without a graphics chip eats a core."""
    monitor_url = monitor.web_url.replace("http", "ws").replace("?", "commands?")
    processes = [
        subprocess.Popen([sys.executable, "-c", PAGE, url, answer], stdout=subprocess.PIPE)
        for url, answer in ((meshcat.ws_url(), ""), (monitor_url, "drawn"))
    ]
    try:
        assert all(process.stdout.readline() for process in processes)
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def run_once(scenario, meshcat=None, monitor=None):
    """Wall-clock time in s of a run, not held to real time."""
    if meshcat is not None:
        meshcat.DeleteRecording()
        meshcat.StartRecording(set_visualizations_while_recording=True)
    experiment = make_experiment(scenario, meshcat=meshcat, monitor=monitor)
    start = time.perf_counter()
    experiment.run()
    return time.perf_counter() - start


@pytest.mark.slow
@pytest.mark.parametrize("watched", [False, True], ids=["no browser", "a page each"])
def test_a_run_with_both_screens(benchmark, watched):
    """With the film for the replay; without a display it is timed in between."""
    enabled = benchmark.enabled
    scenario = load_scenario("chatelain2013_fig5", changes=[f"duration={16 if enabled else 1}"])
    plain, shown = [], []

    def both():
        plain.append(run_once(scenario))
        shown.append(run_once(scenario, meshcat, monitor))

    with Site() as site:
        meshcat, monitor = open_meshcat(site), Monitor(site)
        both()
        with pages_that_draw_nothing(meshcat, monitor) if watched else nullcontext():
            benchmark.pedantic(both, rounds=5 if enabled else 1)
    benchmark.extra_info["compared_with"] = "the same run without a display"
    benchmark.extra_info["ratio"] = min(plain[1:]) / min(shown[1:])
