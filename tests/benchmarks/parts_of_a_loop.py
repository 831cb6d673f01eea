"""Cost of the loop and of its parts, in a process of its own; version 0.2.0 can run it, too.

python tests/benchmarks/parts_of_a_loop.py [loop] prints milliseconds by name, as JSON: those of the
loop of fig. 5, or everything.
"""

import json
import sys
import time

import sonoservo.systems  # noqa: F401  (before NumPy: it sets the number of threads)

import numpy as np  # isort: skip

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.experiments.following import FollowingExperiment

FIG5 = "chatelain2013_fig5"
SETTLED, MEASURED = 3.0, 12.0
"""Time in s at which the kernels are loaded, and duration with and without a needle, in s."""


def loop(scenario):
    """Wall time and processor time of a volume in the closed loop, and of its parts, in ms."""
    experiment = FollowingExperiment(load_scenario(scenario, seed=100))
    experiment.start()
    experiment.advance(SETTLED)
    before = len(experiment.compute["track"])
    began = time.perf_counter(), time.process_time()
    experiment.advance(SETTLED + MEASURED)
    ended = time.perf_counter(), time.process_time()
    volumes = len(experiment.compute["track"]) - before
    wall, processor = (
        1e3 * (end - start) / volumes for start, end in zip(began, ended, strict=True)
    )
    track = 1e3 * np.array(experiment.compute["track"][before:])
    return {
        f"{scenario}: a volume in the loop, wall": wall,
        f"{scenario}: a volume in the loop, processor": processor,
        f"{scenario}: rendering in the loop": 1e3 * np.mean(experiment.compute["render"][before:]),
        f"{scenario}: tracking, median": np.median(track),
        f"{scenario}: tracking, slowest": np.max(track),
    }


def first_volume():
    """Processor time from the start of the process to the first volume in ms."""
    experiment = FollowingExperiment(load_scenario(FIG5, seed=100))
    experiment.start()
    experiment.advance(0.35)
    assert experiment.compute["track"]
    return 1e3 * time.process_time()


def measure(only_loop):
    start = first_volume()
    measured = loop(FIG5)
    if only_loop:
        return measured
    return {
        "start of the program to the first volume": start,
        **measured,
        **loop("clinic"),
    }


if __name__ == "__main__":
    json.dump(measure("loop" in sys.argv), sys.stdout)
