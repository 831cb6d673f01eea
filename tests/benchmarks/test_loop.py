"""The whole loop: simulated time per wall time, processor time of a volume, and where it goes.

A sampler looks at the main thread's stack a few hundred times a second and names the leaf whose
callback is running. The picture is written beside the report of the benchmarks.
"""

import sys
import threading
import time
from collections import Counter
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.experiments.following import FollowingExperiment

PICTURE = Path("out/loop_cost.png")
SETTLED = 9.0
"""Time in s at which the kernels are loaded and the needle is in view."""
MEASURED = 8.0
CALLBACKS = ("_calc", "_update", "_sample", "_look")


class Sampler(threading.Thread):
    """Counts what the main thread is doing."""

    def __init__(self, period=0.004):
        super().__init__(daemon=True)
        self.counts, self.period, self.going = Counter(), period, True

    def run(self):
        main = threading.main_thread().ident
        while self.going:
            self.counts[leaf(sys._current_frames()[main])] += 1
            time.sleep(self.period)


def leaf(frame):
    """Return the class of the innermost callback of a leaf, or Drake outside all of them."""
    while frame is not None:
        if frame.f_code.co_name.startswith(CALLBACKS) and "self" in frame.f_locals:
            return type(frame.f_locals["self"]).__name__
        if frame.f_code.co_name in ("AdvanceTo", "advance"):
            break
        frame = frame.f_back
    return "Drake: plant, contact, events"


def draw(milliseconds, title):
    named = sorted(milliseconds.items(), key=lambda each: each[1])
    figure = Figure(figsize=(8, 0.3 * len(named) + 1.2), layout="constrained")
    axes = figure.subplots()
    axes.barh([name for name, _ in named], [ms for _, ms in named], color="#4477aa")
    axes.set(xlabel="ms a volume", title=title)
    axes.title.set_fontsize(10)
    axes.grid(axis="x", alpha=0.3)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=120)


@pytest.mark.slow
def test_loop_of_figure_5(benchmark):
    def run():
        scenario = load_scenario("chatelain2013_fig5", seed=100)
        experiment = FollowingExperiment(scenario)
        experiment.start()
        experiment.advance(SETTLED)
        before = len(experiment.compute["track"])
        sampler = Sampler()
        clocks = (time.perf_counter, time.process_time, time.thread_time)
        start = [clock() for clock in clocks]
        sampler.start()
        experiment.advance(SETTLED + MEASURED)
        wall, processor, main = (clock() - at for clock, at in zip(clocks, start, strict=True))
        sampler.going = False
        volumes = len(experiment.compute["track"]) - before
        return volumes, wall, processor, main, sampler.counts

    volumes, wall, processor, main, counts = benchmark.pedantic(run, rounds=1)
    assert volumes > 20
    share = 1e3 / volumes / sum(counts.values())
    parts = {name: wall * share * count for name, count in counts.items()}
    parts["Kernels beside the main thread"] = 1e3 * (processor - main) / volumes
    figures = {
        "simulated_per_wall_time": MEASURED / wall,
        "wall_ms_a_volume": 1e3 * wall / volumes,
        "processor_ms_a_volume": 1e3 * processor / volumes,
        "main_thread_ms_a_volume": 1e3 * main / volumes,
    }
    benchmark.extra_info.update(figures)
    title = (
        f"fig. 5: {figures['simulated_per_wall_time']:.1f} x real time, "
        f"{figures['wall_ms_a_volume']:.0f} ms of wall and "
        f"{figures['processor_ms_a_volume']:.0f} ms of processor a volume"
    )
    draw(parts, title)
    print(f"\n{title}; see {PICTURE}")
