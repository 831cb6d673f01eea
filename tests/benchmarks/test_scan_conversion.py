"""Scan conversion beside SciPy's interpolation at coordinates that are worked out beforehand."""

import time

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from sonoservo.systems.signals import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound import (
    ImagingParameters,
    ScanConversion,
    Transducer,
    make_grid,
    sweep_geometry,
)

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
LOOP = sweep_geometry(Transducer(), ImagingParameters())
CASES = {
    "61 x 128 x 480 at 0.5 mm": (LARGE, 0.5e-3, None),
    "61 x 128 x 480, a region": (LARGE, 0.5e-3, [[-0.05, 0.04, -0.01], [0.05, 0.06, 0.01]]),
    "27 x 96 x 293 at 0.7 mm": (LOOP, 0.7e-3, None),
}


def make_sweep(geometry):
    rng = np.random.default_rng(0)
    times = geometry.frame_period * np.arange(geometry.frames)
    poses = np.tile(np.eye(4), (geometry.frames, 1, 1))
    samples = rng.integers(0, 256, geometry.shape, np.uint8)
    return Sweep(samples, SweepMotion(geometry, 1, times, poses))


@pytest.mark.parametrize("case", CASES)
def test_convert(benchmark, case):
    geometry, spacing, region = CASES[case]
    grid = make_grid(geometry, spacing, *(region or ()))
    conversion = ScanConversion(geometry, grid)
    benchmark.extra_info["megavoxels"] = float(np.prod(grid.shape)) / 1e6
    sweep = make_sweep(geometry)
    volume = benchmark(conversion, sweep)
    assert volume.intensities.max() > 240
    if benchmark.stats is None:
        return
    # Rows of the grid until there are 2 million places: SciPy's time is proportional to them.
    share = min(1.0, 2e6 / np.prod(grid.shape))
    rows = np.unique(np.linspace(0, grid.shape[0] - 1, int(share * grid.shape[0])).astype(int))
    p_P = np.stack(np.meshgrid(grid.axis(0)[rows], grid.axis(1), grid.axis(2), indexing="ij"), -1)
    coordinates = np.stack(geometry.index(p_P, 1)).astype(np.float32)
    started = time.perf_counter()
    map_coordinates(sweep.samples, coordinates, order=1, prefilter=False)
    scipy_s = (time.perf_counter() - started) * grid.shape[0] / len(rows)
    benchmark.extra_info["compared_with"] = "scipy.ndimage.map_coordinates, coordinates given"
    benchmark.extra_info["ratio"] = scipy_s / benchmark.stats.stats.median
