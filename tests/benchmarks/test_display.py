"""What the scanner's monitor costs a run, and the thread that draws it."""

import numpy as np
import pytest
from meshcat import Visualizer
from synthetic_volumes import Scene, entry_on_side

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
