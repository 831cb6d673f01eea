import numpy as np
import pytest

from sonoservo.diagrams.papers.chatelain2013.method.volume_difference import top_differences

SHAPE = (17, 13, 11)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_are_the_order_statistic(dtype):
    rng = np.random.default_rng(0)
    a, b = (rng.integers(1, 255, SHAPE).astype(dtype) for _ in range(2))
    index, threshold = top_differences(a, b, 50)
    difference = np.abs(a.astype(float) - b)
    assert len(np.unique(index, axis=0)) == 50
    assert threshold == np.sort(difference.ravel())[-50]
    assert difference[tuple(index.T)].min() == threshold


def test_ties_are_chosen_from_the_whole_volume():
    a, b = np.full(SHAPE, 9, np.uint8), np.full(SHAPE, 4, np.uint8)
    index, threshold = top_differences(a, b, 200)
    assert (len(index), threshold) == (200, 5)
    np.testing.assert_allclose(index.mean(axis=0), (np.array(SHAPE) - 1) / 2, atol=1.2)


def test_nothing_changed():
    a = np.full(SHAPE, 7, np.uint8)
    index, threshold = top_differences(a, a, 10)
    assert (len(index), threshold) == (0, 0)


def test_fewer_changed_than_wanted():
    a = np.full(SHAPE, 7, np.uint8)
    b = a.copy()
    b[3, 4, 5] = 9
    index, threshold = top_differences(a, b, 10)
    np.testing.assert_array_equal(index, [[3, 4, 5]])
    assert threshold == 2


def test_outside_a_moving_sector_is_no_change():
    a, b = np.full(SHAPE, 30, np.uint8), np.full(SHAPE, 30, np.uint8)
    b[0] = 0
    b[5, 5, 5] = 40
    index, _ = top_differences(a, b, 5, seen=(a > 0, b > 0))
    np.testing.assert_array_equal(index, [[5, 5, 5]])
