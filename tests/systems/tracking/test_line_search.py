from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.cells import cells_of
from sonoservo.systems.tracking.line_search import bright_lines

BALLS = [([0.005, 0.06, 0.008], 2e-3), ([-0.01, 0.035, -0.004], 1.5e-3)]
ENTRY = entry_on_side()
K = np.array([0.92, 0.25, 0.3]) / np.linalg.norm([0.92, 0.25, 0.3])
NEEDLE = (ENTRY, ENTRY + 0.035 * K)


def test_the_bottom_of_the_tissue_is_no_line():
    volume = Scene(seed=5, spacing=1e-3, balls=BALLS).volume(1, lambda time: NEEDLE)
    depth = volume.origin[1] + volume.spacing[1] * np.arange(volume.intensities.shape[1])
    beneath = (depth > 0.07)[np.newaxis, :, np.newaxis] & (volume.intensities > 0)
    volume = replace(volume, intensities=np.where(beneath, np.uint8(1), volume.intensities))
    middles, directions = bright_lines(cells_of(volume), 10)
    assert abs(directions[0] @ K) > np.cos(np.radians(10))
    assert np.abs(middles[0, 1] - 0.5 * (NEEDLE[0] + NEEDLE[1])[1]) < 5e-3


def test_no_more_lines_than_asked_for_and_none_where_there_is_nothing():
    volume = Scene(seed=5, spacing=1e-3).volume(1, lambda time: NEEDLE)
    dark = replace(volume, intensities=np.zeros_like(volume.intensities))
    for each, count in ((volume, 2), (dark, 0)):
        middles, directions = bright_lines(cells_of(each), 2)
        assert middles.shape == directions.shape == (count, 3)


@settings(max_examples=8, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    azimuth=st.floats(-np.pi, np.pi),
    dip=st.floats(-1.1, 1.1),
    spacing=st.sampled_from(
        [[1e-3, 1e-3, 1e-3], [0.5e-3, 0.7e-3, 1.1e-3], [1.6e-3, 0.8e-3, 1.6e-3]]
    ),
)
def test_a_line_is_found_wherever_it_lies_and_on_any_grid(seed, azimuth, dip, spacing):
    rng = np.random.default_rng(seed)
    extent = np.array([60e-3, 50e-3, 45e-3])
    centre = extent * rng.uniform(0.35, 0.65, 3)
    k = np.array([np.cos(dip) * np.cos(azimuth), np.sin(dip), np.cos(dip) * np.sin(azimuth)])
    points = np.stack(np.indices(np.ceil(extent / spacing).astype(int)), -1) * spacing - centre
    along = points @ k
    away = np.linalg.norm(points - along[..., np.newaxis] * k, axis=-1)
    needle = 70 * np.exp(-((away / 1.2e-3) ** 2)) * (np.abs(along) < 14e-3)
    volume = Volume(
        intensities=np.clip(rng.normal(100, 20, away.shape) + needle, 1, 255).astype(np.uint8),
        origin=np.zeros(3), spacing=np.array(spacing), X_WP=RigidTransform(), time=0.0,
        decibels_per_level=0.25,
    )  # fmt: skip
    middles, directions = bright_lines(cells_of(volume), 1)
    d = middles[0] - centre
    assert np.linalg.norm(d - (d @ k) * k) < 2e-3
    assert abs(d @ k) < 8e-3
    assert abs(directions[0] @ k) > 0.97
