from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound.slice_converter import SliceConversion, SliceConverter

PITCHES = np.deg2rad(0.5), np.deg2rad(0.01), 0.1e-3
GEOMETRY = SweepGeometry(0.01, 0.01, *PITCHES, lines=101, frames=1, samples=451, frame_period=0.05)


def sweep_of(values, X_WP=None, time=1.0):
    pose = (X_WP or RigidTransform()).GetAsMatrix4()[np.newaxis]
    samples = values.astype(np.uint8)[np.newaxis]
    return Sweep(samples, SweepMotion(GEOMETRY, 1, np.array([time]), pose))


def test_a_slice_shows_every_sample_where_it_was_acquired():
    # Grey levels that depend linearly on the position: bilinear interpolation keeps them.
    j, i = np.meshgrid(np.arange(101), np.arange(451), indexing="ij")
    x, y, _ = np.moveaxis(GEOMETRY.position(0, j, i, 1), -1, 0)
    image = SliceConversion(GEOMETRY, 0.2e-3)(sweep_of(np.rint(100 + 2000 * x + 2000 * y)))
    ni, nj = np.meshgrid(*(np.arange(n) for n in image.intensities.shape), indexing="ij")
    at = image.position(np.stack([ni, nj], axis=-1))
    shown = image.intensities > 0
    assert shown.mean() > 0.5
    inside = shown & (np.hypot(at[..., 0], at[..., 1] + 0.01) < 0.054)
    expected = 100 + 2000 * at[..., 0] + 2000 * at[..., 1]
    assert np.abs(image.intensities - expected)[inside].max() <= 1.6


def test_beams_come_from_the_arrays_centre():
    image = SliceConversion(GEOMETRY, 0.2e-3)(sweep_of(np.full((101, 451), 9)))
    line = GEOMETRY.position(0, [80, 80], [0, 300], 1)[:, :2]
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    assert np.allclose(image.beam_direction(line[1]), along, atol=1e-9)
    parallel = replace(image, apex=-np.inf)
    assert np.allclose(parallel.beam_direction([0.01, 0.02]), [0, 1])


def test_sweeps_of_many_frames_are_refused():
    with pytest.raises(ValueError, match="frames: 3"):
        SliceConversion(replace(GEOMETRY, frames=3), 0.2e-3)


def test_the_converter_passes_on_that_there_is_none_and_converts_what_there_is():
    converter = SliceConverter(geometry=GEOMETRY, spacing=0.2e-3)
    context = converter.CreateDefaultContext()
    port = converter.GetInputPort("sweep")
    port.FixValue(context, Value[object](NotFound("no sweep is complete yet")))
    assert not converter.GetOutputPort("slice").Eval(context)
    sweep = sweep_of(np.full((101, 451), 50), time=2.5)
    port.FixValue(context, Value[object](sweep))
    image = converter.GetOutputPort("slice").Eval(context)
    assert image.time == 2.5
    assert set(np.unique(image.intensities)) <= {0, 50}
