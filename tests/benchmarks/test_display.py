"""What the console and the world cost a run, and the thread that draws them."""

import os
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest
from bokeh.document import Document
from synthetic_volumes import ENTRY, Scene

from sonoservo.diagrams import load_scenario, make_experiment
from sonoservo.systems.display import Console, Site, open_meshcat
from sonoservo.systems.display.console.console import picture_volume
from sonoservo.systems.display.console.document import PageDocument
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode

TIP = ENTRY + np.array([0.045, 0.012, 0.005])
ALONE = os.environ | {
    "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1] / "helpers"), *sys.path])
}
PERIOD = 0.303
"""Of the volumes of fig. 5, in s."""


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
    console = Console()
    benchmark(lambda: console.show(*shown))
    console.close()
    compare(benchmark)


def test_drawing_a_volume(benchmark, shown):
    """On the site's thread: the slices once, and the figures of one page."""
    page = PageDocument(Document(), "a page")
    benchmark(lambda: page.show({}, frame=picture_volume(*shown, 1)))
    compare(benchmark)


WORLD = """
import asyncio, re, sys
from urllib.parse import urlsplit
from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

async def watch(url):
    origin = f"http://{urlsplit(url).netloc}"
    request = HTTPRequest(url, headers={"Origin": origin})
    page = await websocket_connect(request, max_message_size=1 << 30)
    print("open", flush=True)
    while (message := await page.read_message()) is not None:
        for name in sorted(set(re.findall(rb"cas-v1/[0-9a-f]{64}", message))):
            address = url.replace("ws:", "http:").replace("?", name.decode() + "?")
            await AsyncHTTPClient().fetch(address, raise_error=False)

asyncio.run(watch(sys.argv[1]))
"""
CONSOLE = """
import sys
from page_clients.console_socket import pull_console

sys.setrecursionlimit(10**6)  # Bokeh's client goes one deeper with each message
session = pull_console(sys.argv[1])
(holder,) = (root for root in session.document.roots if root.name == "mode")
holder.tags[3].tags = [10**9]  # it has drawn whatever comes
print("open", flush=True)
session._connection.loop_until_closed()
"""


@contextmanager
def pages_that_draw_nothing(meshcat, console):
    """Processes that fetch all a page would: a browser without a graphics chip eats a core."""
    processes = [
        subprocess.Popen([sys.executable, "-c", program, url], stdout=subprocess.PIPE, env=ALONE)
        for program, url in ((WORLD, meshcat.ws_url()), (CONSOLE, console.web_url))
    ]
    try:
        assert all(process.stdout.readline() for process in processes)
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def run_once(scenario, meshcat=None, console=None):
    """Wall-clock and processor time in s of a run, not held to real time."""
    if meshcat is not None:
        meshcat.DeleteRecording()
        meshcat.StartRecording(set_visualizations_while_recording=True)
    experiment = make_experiment(scenario, meshcat=meshcat, console=console)
    start = time.perf_counter(), time.process_time()
    experiment.run()
    return time.perf_counter() - start[0], time.process_time() - start[1]


@pytest.mark.slow
@pytest.mark.parametrize("watched", [None, pages_that_draw_nothing])
def test_a_run_with_a_console(benchmark, watched):
    """With the film for the replay; without a display it is timed in between.

    ``share`` is what the display adds to the processor time of the run's process, as a share of
    that without one: medians over pairs, which leave out what else the machine does.
    """
    enabled = benchmark.enabled
    duration = 16 if enabled else 1
    scenario = load_scenario("chatelain2013_fig5", changes=[f"duration={duration}"])
    plain, shown = [], []

    def both():
        plain.append(run_once(scenario))
        shown.append(run_once(scenario, meshcat, console))

    with Site() as site:
        meshcat, console = open_meshcat(site), Console(site, world="world")
        both()
        with watched(meshcat, console) if watched else nullcontext():
            benchmark.pedantic(both, rounds=5 if enabled else 1)
    benchmark.extra_info["compared_with"] = "the same run without a display"
    alone, together = np.array(plain[1:]), np.array(shown[1:])
    benchmark.extra_info["ratio"] = float(np.median(alone[:, 0] / together[:, 0]))
    benchmark.extra_info["share"] = float(np.median(together[:, 1] / alone[:, 1])) - 1
    factors = np.median(duration / alone[:, 0]), np.median(duration / together[:, 0])
    benchmark.extra_info["real_time_factors"] = [float(each) for each in factors]
