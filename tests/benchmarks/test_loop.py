"""The whole loop: simulated time per wall time, processor time of a volume, and where it goes.

A sampler asks each thread's clock a few hundred times a second, and looks at its stack for the leaf
whose callback is running. It sees a thread only where that hands over the interpreter, so callbacks
of less than some milliseconds, as those of the controller, count as Drake. The picture is written
beside the report of the benchmarks. The loop runs in a process of its own, as a user starts it.
"""

import json
import os
import subprocess
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
MEASURED = 6.0
CALLBACKS = ("_calc", "_update", "_sample", "_look")
DRAKE = "Drake and short callbacks"
PARTS = {
    "rendering": ("ultrasound/simulation",),
    "conversion": ("ultrasound",),
    "tracking": ("tracking",),
    "plant, contact, needle, control": ("drake", "robot", "needle", "control"),
    "display and log": ("display", "evaluation", "recording"),
    "other": ("",),
}
"""Parts of the loop and the rooms of their code; the first one that fits counts."""


class Sampler(threading.Thread):
    """Adds up the processor time that the leaves take, in s, by their part and name."""

    def __init__(self, period=0.004):
        super().__init__(daemon=True)
        self.seconds, self._period, self._going = Counter(), period, True

    def run(self):
        before = self._clocks()
        while self._going:
            time.sleep(self._period)
            frames, clocks = sys._current_frames(), self._clocks()
            spent = {thread: now - before.get(thread, 0.0) for thread, now in clocks.items()}
            # Numba's threads have no stack of Python; they work for the main thread.
            own, process = spent.pop(self.ident), spent.pop("process")
            spent[threading.main_thread().ident] += process - own - sum(spent.values())
            for thread, seconds in spent.items():
                if thread in frames:
                    self.seconds[leaf(frames[thread])] += seconds
            before = clocks

    def _clocks(self):
        clocks = {"process": time.process_time()}
        for thread in threading.enumerate():
            clocks[thread.ident] = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
        return clocks

    def end(self):
        self._going = False
        self.join()


def leaf(frame):
    """Return part and class of the innermost callback of a leaf, or Drake outside all of them."""
    room = None
    while frame is not None:
        _, ours, path = frame.f_code.co_filename.rpartition("/systems/")
        if ours:
            room = room or path
            if frame.f_code.co_name.startswith(CALLBACKS) and "self" in frame.f_locals:
                return part_of(path), type(frame.f_locals["self"]).__name__
        if frame.f_code.co_name in ("AdvanceTo", "advance"):
            return part_of("drake"), DRAKE
        frame = frame.f_back
    return (part_of(room), Path(room).stem) if room else ("other", "waiting threads")


def part_of(path):
    return next(part for part, rooms in PARTS.items() if path.startswith(rooms))


def draw(milliseconds, title):
    """Draw processor time in ms by part and leaf."""
    parts = Counter()
    for (part, _), ms in milliseconds.items():
        parts[part] += ms
    order = {part: k for k, (part, _) in enumerate(parts.most_common())}
    total = sum(parts.values())
    small = Counter()
    for (part, name), ms in milliseconds.items():
        small[part, name if ms > 0.004 * total else "small ones"] += ms
    rows = [row for row in small.items() if row[1] > 0.001 * total]
    rows.sort(key=lambda row: (-order[row[0][0]], row[1]))
    figure = Figure(figsize=(9, 0.24 * len(rows) + 1.6), layout="constrained")
    axes = figure.subplots()
    bars = {part: [k for k, ((of, _), _) in enumerate(rows) if of == part] for part in order}
    for part, at in bars.items():
        label = f"{part}: {parts[part]:.1f} ms"
        axes.barh(at, [rows[k][1] for k in at], color=f"C{order[part]}", label=label)
    axes.set_yticks(range(len(rows)), [name for (_, name), _ in rows], fontsize=8)
    axes.set(xlabel="processor time / ms a volume", title=title, ylim=(-0.6, len(rows) - 0.4))
    axes.title.set_fontsize(10)
    axes.legend(loc="lower right", fontsize=9)
    axes.grid(axis="x", alpha=0.3)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=120)
    return parts


def measure():
    """Return figures of the loop, and processor time in ms a volume by part and leaf."""
    experiment = FollowingExperiment(load_scenario("chatelain2013_fig5", seed=100))
    experiment.start()
    experiment.advance(SETTLED)
    before = len(experiment.compute["track"])
    sampler = Sampler()
    clocks = (time.perf_counter, time.process_time, time.thread_time)
    start = [clock() for clock in clocks]
    sampler.start()
    experiment.advance(SETTLED + MEASURED)
    wall, processor, main = (clock() - at for clock, at in zip(clocks, start, strict=True))
    sampler.end()
    volumes = len(experiment.compute["track"]) - before
    figures = {
        "volumes": volumes,
        "simulated_per_wall_time": MEASURED / wall,
        "wall_ms_a_volume": 1e3 * wall / volumes,
        "processor_ms_a_volume": 1e3 * processor / volumes,
        "main_thread_ms_a_volume": 1e3 * main / volumes,
    }
    return figures, [[*name, 1e3 * each / volumes] for name, each in sampler.seconds.items()]


def measured_in_a_process(threads):
    """Return what `measure` does in a process of its own, with what the environment has to say."""
    environment = {k: v for k, v in os.environ.items() if not k.endswith("NUM_THREADS")}
    environment.pop("OMP_WAIT_POLICY", None)
    if threads is not None:
        environment.update(OMP_NUM_THREADS=threads, NUMBA_NUM_THREADS=threads)
    command = [sys.executable, __file__]
    ran = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    return json.loads(ran.stdout)


@pytest.mark.slow
@pytest.mark.bench
def test_loop_of_figure_5(benchmark):
    figures, leaves = benchmark.pedantic(measured_in_a_process, args=(None,), rounds=1)
    assert figures["volumes"] > 15
    title = (
        f"fig. 5: {figures['simulated_per_wall_time']:.1f} x real time, "
        f"{figures['wall_ms_a_volume']:.0f} ms of wall and "
        f"{figures['processor_ms_a_volume']:.0f} ms of processor a volume"
    )
    parts = draw({(part, name): ms for part, name, ms in leaves}, title)
    benchmark.extra_info.update(figures, processor_ms_a_volume_by_part=dict(parts))
    print(f"\n{title}; see {PICTURE}")
    # A single thread never waits for another one, so it takes what the parts need.
    needed, _ = measured_in_a_process("1")
    spent, needed = (each["processor_ms_a_volume"] for each in (figures, needed))
    benchmark.extra_info["processor_time_of_one_thread_ms_a_volume"] = needed
    assert spent <= 1.15 * needed, f"{spent:.0f} ms of processor a volume; {needed:.0f} are needed"


if __name__ == "__main__":
    print(json.dumps(measure()))
