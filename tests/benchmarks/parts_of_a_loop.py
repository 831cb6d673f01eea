"""Cost of the loop and of its parts, in a process of its own; version 0.2.0 can run it, too.

python tests/benchmarks/parts_of_a_loop.py [loop] prints milliseconds by name, as JSON: those of the
loop of fig. 5, or everything.
"""

import json
import sys
import time

import sonoservo.systems  # noqa: F401  (before NumPy: it sets the number of threads)

import numpy as np  # isort: skip

from sonoservo.diagrams import FollowingExperiment, load_scenario
from sonoservo.systems.signals import Needle, Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound import ImagingParameters, ScanConversion, Transducer, make_grid
from sonoservo.systems.ultrasound.simulation import ScannerParameters, SweepRenderer, load_tissue

FIG5 = "chatelain2013_fig5"
SETTLED, MEASURED = 3.0, 12.0
"""Time in s at which the kernels are loaded, and duration with and without a needle, in s."""
NEEDLE = Needle(np.array([[-0.06, 0.01, -0.045], [0.02, 0.0, -0.045]]), 0.635e-3)
DOWN = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.004], [0, 0, 0, 1.0]])
LARGE = SweepGeometry(
    array_radius=0.04,
    motor_radius=0.02725,
    line_pitch=np.deg2rad(0.608768),
    frame_pitch=np.deg2rad(1.4634),
    sample_pitch=0.12 / 479,
    lines=128,
    frames=61,
    samples=480,
    frame_period=0.02,
)


def best(function, rounds):
    """Least processor time of a call in ms, of all threads; the first call does not count."""
    times = []
    for _ in range(rounds + 1):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return 1e3 * min(times[1:])


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


def rendering():
    """Processor time of a sweep over agar with a needle, of a moving probe and of one at rest."""
    renderer = SweepRenderer(
        transducer=Transducer(),
        imaging=ImagingParameters(),
        tissue=load_tissue("agar"),
        parameters=ScannerParameters(),
        seed=0,
    )
    frames, numbers = renderer.geometry.frames, iter(range(1000))
    poses = np.repeat(DOWN[np.newaxis], frames, axis=0)

    def render(speed):
        poses[:, 0, 3] += speed
        renderer.render(poses, [NEEDLE] * frames, 1, next(numbers))

    return [best(lambda speed=speed: render(speed), 12) for speed in (1e-6, 0.0)]


def conversion():
    """Processor time of 44 million voxels, of a probe at rest and with its motion compensated."""
    grid = make_grid(LARGE, 0.5e-3)
    poses = np.tile(np.eye(4), (LARGE.frames, 1, 1))
    times = LARGE.frame_period * np.arange(LARGE.frames)
    poses[:, 0, 3] = 0.01 * times
    samples = np.random.default_rng(0).integers(0, 256, LARGE.shape, np.uint8)
    sweep = Sweep(samples, SweepMotion(LARGE, 1, times, poses))
    at_rest, moving = (ScanConversion(LARGE, grid, compensate_motion=c) for c in (False, True))
    return [best(lambda convert=convert: convert(sweep), 4) for convert in (at_rest, moving)]


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
    moves, still = rendering()
    at_rest, compensated = conversion()
    return {
        "start of the program to the first volume": start,
        **measured,
        **loop("clinic"),
        "rendering, probe moves": moves,
        "rendering, probe still": still,
        "conversion of 44 Mvoxel": at_rest,
        "conversion of 44 Mvoxel, motion compensated": compensated,
    }


if __name__ == "__main__":
    json.dump(measure("loop" in sys.argv), sys.stdout)
