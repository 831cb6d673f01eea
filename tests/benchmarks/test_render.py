"""Rendering of whole sweeps. A paper-sized one, at 3.3 volumes a second, takes 303 ms to acquire.

`make bench` prints milliseconds a sweep; ``extra_info`` of its JSON says what a row is compared
with, and the ratio.
"""

import dataclasses
import time

import numpy as np
import pytest
from pymust_referee import middle_line

from sonoservo.diagrams.papers.zhao2012.phantom import IMAGING as ZHAO
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.structures.kinds import (
    Bone,
    Calcification,
    Fascia,
    FatLayer,
    Gas,
    NWires,
    RestingNeedle,
    Vessel,
)
from sonoservo.systems.ultrasound.simulation.tissue import load_tissue
from sonoservo.systems.ultrasound.transducer import Transducer, load_transducer

LARGE = ImagingParameters(depth=0.1476, sector=1.0, frames=31, volume_rate=1.3)
SIZES = {
    "27 x 96 x 293": ("4dc7_3_40", ImagingParameters()),
    "31 x 128 x 480": ("4dc7_3_40", LARGE),
    "53 x 71 x 2608": ("zhao2012", ZHAO),
}
NEEDLE = Needle(np.array([[-0.06, 0.01, -0.045], [0.02, 0.0, -0.045]]), 0.635e-3)
DOWN = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.004], [0, 0, 0, 1.0]])


def make_renderer(size, scatterers_per_cell=4.0):
    transducer, imaging = SIZES[size]
    renderer = SweepRenderer(
        transducer=load_transducer(transducer),
        imaging=imaging,
        tissue=dataclasses.replace(load_tissue("agar"), scatterers_per_cell=scatterers_per_cell),
        parameters=ScannerParameters(),
        seed=0,
    )
    assert size == " x ".join(str(extent) for extent in renderer.geometry.shape)
    return renderer


def sweep_after_sweep(renderer, speed):
    """A function that renders the next sweep; the probe moves by ``speed`` in m a sweep."""
    frames = renderer.geometry.frames
    poses = np.repeat(DOWN[np.newaxis], frames, axis=0)
    numbers = iter(range(10**6))

    def render():
        poses[:, 0, 3] += speed
        return renderer.render(poses, [NEEDLE] * frames, 1, next(numbers))

    render()
    return render


def compare(benchmark, with_what, seconds):
    benchmark.extra_info["compared_with"] = with_what
    benchmark.extra_info["alternative_ms"] = 1e3 * seconds
    if benchmark.stats is not None:
        benchmark.extra_info["ratio"] = seconds / benchmark.stats.stats.median


@pytest.mark.parametrize("speed", [1e-6, 0.0], ids=["probe moves", "probe still"])
@pytest.mark.parametrize("size", SIZES)
def test_render(benchmark, size, speed):
    renderer = make_renderer(size)
    grey = benchmark(sweep_after_sweep(renderer, speed))
    assert grey.mean() > 15
    compare(benchmark, "the time the sweep takes to acquire", renderer.geometry.period)


@pytest.mark.parametrize("scatterers_per_cell", [1, 4, 16])
def test_render_denser_tissue(benchmark, scatterers_per_cell):
    renderer = make_renderer("31 x 128 x 480", scatterers_per_cell)
    grey = benchmark(sweep_after_sweep(renderer, 1e-6))
    assert grey.mean() > 15
    compare(benchmark, "the time the sweep takes to acquire", renderer.geometry.period)


def seconds_per_point_by_pymust():
    """On one line."""
    points = np.random.default_rng(0).uniform([-3e-3, 0.03, 1e-4], [3e-3, 0.06, 3e-3], (200, 3))
    seconds = []
    for count in (20, 20, 200):  # the first one loads what PyMUST loads late
        start = time.perf_counter()
        middle_line(Transducer(), ImagingParameters(), points[:count], np.ones(count), 0.045)
        seconds.append(time.perf_counter() - start)
    return (seconds[2] - seconds[1]) / 180


def test_render_instead_of_pymust(benchmark):
    """What PyMUST would take: its time for a point on one line, for those in every line's beam.

    Extrapolated from 200 points, linearly in the number of points and of lines. PyMUST computes
    what every element receives; the renderer's point spread function has summed it up beforehand.
    """
    renderer = make_renderer("27 x 96 x 293")
    beam, geometry = renderer.beam, renderer.geometry
    # Two and a half standard deviations of the beam each way, four points in a resolution cell.
    cross_section = 5 * beam.elevation * 5 * beam.lateral
    cells = (cross_section / (2**1.5 * beam.resolution_cell)).sum() * geometry.sample_pitch
    per_sweep = seconds_per_point_by_pymust() * 4 * cells * geometry.lines * geometry.frames
    grey = benchmark(sweep_after_sweep(renderer, 1e-6))
    assert grey.mean() > 15
    compare(benchmark, "PyMUST, extrapolated from 200 points on one line", per_sweep)


STRUCTURES = [
    Bone(start=[0.03, -0.02, -0.05], end=[0.03, 0.02, -0.05]),
    Vessel(path=[[-0.03, -0.01, -0.055], [0.02, 0.012, -0.052]]),
    Fascia(size=[0.04, 0.03]),
    Calcification(),
    Gas(size=[0.012, 0.012], centre=[-0.02, 0, -0.07]),
    NWires(),
    RestingNeedle(start=[-0.05, 0.02, -0.03], end=[0.0, 0.012, -0.05]),
]
DIALS = NeedleEchoParameters(fading_db=4.0, diffuse_lobe_deg=30.0, tip="bevel")
FAT = FatLayer(thickness=0.012)
WORLDS = {
    "one of each structure": ({"structures": STRUCTURES}, NeedleEchoParameters()),
    "fat": ({"fat": FAT}, NeedleEchoParameters()),
    "needle dials": ({}, DIALS),
    "everything": ({"structures": STRUCTURES, "fat": FAT, "sound_speed": 1500.0}, DIALS),
    "liver": ("liver", NeedleEchoParameters()),
}


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
def test_render_harder_worlds(benchmark, world):
    """Against the clean phantom of the same size, rendered by turns; the probe moves."""
    changes, needle = WORLDS[world]
    if changes == "liver":
        tissue = load_tissue("liver")
    else:
        tissue = dataclasses.replace(load_tissue("agar"), **changes)
    renderer = SweepRenderer(
        transducer=Transducer(),
        imaging=ImagingParameters(),
        tissue=tissue,
        parameters=ScannerParameters(needle=needle),
        seed=0,
    )
    clean = sweep_after_sweep(make_renderer("27 x 96 x 293"), 1e-6)
    seconds = []

    def clean_first():
        start = time.process_time()
        clean()
        seconds.append(time.process_time() - start)

    harder = sweep_after_sweep(renderer, 1e-6)
    taken = []

    def timed():
        start = time.process_time()
        grey = harder()
        taken.append(time.process_time() - start)
        return grey

    assert benchmark.pedantic(timed, setup=clean_first, rounds=12).mean() > 15
    benchmark.extra_info["compared_with"] = "processor time of the clean phantom"
    benchmark.extra_info["alternative_ms"] = 1e3 * np.median(seconds)
    benchmark.extra_info["ratio"] = np.median(seconds) / np.median(taken)
    benchmark.extra_info["more_ms"] = 1e3 * (np.median(taken) - np.median(seconds))
