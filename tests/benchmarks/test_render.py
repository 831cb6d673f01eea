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
from sonoservo.systems.ultrasound.simulation.rendering import ScannerParameters, SweepRenderer
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
    assert grey.mean() > 30
    compare(benchmark, "the time the sweep takes to acquire", renderer.geometry.period)


@pytest.mark.parametrize("scatterers_per_cell", [1, 2, 4, 8, 16])
def test_render_denser_tissue(benchmark, scatterers_per_cell):
    renderer = make_renderer("31 x 128 x 480", scatterers_per_cell)
    grey = benchmark(sweep_after_sweep(renderer, 1e-6))
    assert grey.mean() > 30
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
    assert grey.mean() > 30
    compare(benchmark, "PyMUST, extrapolated from 200 points on one line", per_sweep)
