"""Images sampled at points: the kernels against SciPy, and the methods of the images."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from scipy.ndimage import map_coordinates

from sonoservo.systems.sampling.interpolation import sample_grid
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume

RNG = np.random.default_rng(0)
ARRAYS = [
    RNG.integers(0, 256, (9, 7)).astype(np.uint8),
    RNG.integers(0, 256, (9, 7, 5)).astype(np.uint8),
    RNG.uniform(0, 255, (2, 3, 4)).astype(np.float32),
]
X = RigidTransform()


@pytest.mark.parametrize("array", ARRAYS)
@pytest.mark.parametrize(("outside", "mode"), [(0.0, "constant"), (None, "nearest")])
def test_the_kernels_agree_with_scipy(array, outside, mode):
    low, high = -2, np.array(array.shape) + 1
    at = RNG.uniform(low, high, (500, array.ndim))
    expected = map_coordinates(array.astype(float), at.T, order=1, mode=mode)
    got = sample_grid(array, at, np.zeros(array.ndim), np.ones(array.ndim), outside)
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-4)


def test_outside_is_as_wished_and_no_number_is_never_inside():
    array = ARRAYS[1]
    points = [[-0.1, 0, 0], [0, 0, 4.1], [np.nan, 0, 0], [0, np.inf, 0]]
    assert (sample_grid(array, points, np.zeros(3), np.ones(3), 7.0) == 7).all()
    nearest = sample_grid(array, points, np.zeros(3), np.ones(3), None)
    np.testing.assert_array_equal(nearest, [array[0, 0, 0], array[0, 0, 4], np.nan, array[0, 6, 0]])


def test_volumes_and_slices_sample_themselves_where_their_elements_lie():
    for image in (
        Volume(ARRAYS[1], [0.1, 0.2, 0.3], [1e-3, 2e-3, 3e-3], X, 0.0),
        Volume(ARRAYS[2], [0.1, 0.2, 0.3], [1e-3, 2e-3, 3e-3], X, 0.0),
        ImageSlice(ARRAYS[0], [0.1, 0.2], [1e-3, 2e-3], X, 0.0),
    ):
        array = image.intensities
        at = np.array(np.unravel_index(np.arange(array.size), array.shape)).T.reshape(
            *array.shape, -1
        )
        np.testing.assert_allclose(image.sample(image.position(at)), array, atol=1e-3)
        half = image.position(np.full(array.ndim, 0.5))
        corner = array[(slice(2),) * array.ndim].astype(float)
        assert image.sample(half) == pytest.approx(corner.mean(), abs=1e-3)
        assert image.sample(image.origin - 1e-3) == 0
        assert image.sample(image.origin - 1e-3, outside=None) == array.flat[0]


@pytest.mark.parametrize("direction", [1, -1])
def test_a_sweep_samples_itself_at_its_own_samples(direction):
    geometry = SweepGeometry(0.04, 0.027, 0.02, 0.03, 1e-3, 8, 5, 20, 0.01)
    samples = RNG.integers(0, 256, geometry.shape).astype(np.uint8)
    poses = np.repeat(np.eye(4)[np.newaxis], 5, axis=0)
    sweep = Sweep(samples, SweepMotion(geometry, direction, np.zeros(5), poses))
    p_P = geometry.position(*np.indices(geometry.shape), direction)
    np.testing.assert_allclose(sweep.sample(p_P, outside=-1), samples, atol=1e-3)
    assert np.isnan(sweep.sample([[0, -0.01, 0], [0.2, 0.01, 0]], outside=np.nan)).all()
