import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import minimize

from sonoservo.diagrams.papers.chatelain2013.method.geometric_median import geometric_median

coordinates = st.integers(-40, 40).map(lambda n: 1e-3 * n)


def cost(y, points):
    return np.linalg.norm(points - y, axis=1).sum()


@given(arrays(float, st.tuples(st.integers(1, 12), st.just(3)), elements=coordinates))
def test_no_other_point_is_closer(points):
    median = geometric_median(points)
    best = min(
        minimize(cost, start, args=(points,), method="Nelder-Mead").fun
        for start in (points.mean(axis=0), median)
    )
    best = min(best, *(cost(p, points) for p in points))
    assert cost(median, points) <= best + 1e-5


def test_agrees_with_an_optimizer():
    points = np.random.default_rng(1).normal(size=(60, 3)) * [1, 2, 3]
    found = minimize(cost, points.mean(axis=0), args=(points,), tol=1e-10)
    np.testing.assert_allclose(geometric_median(points), found.x, atol=1e-4)


def test_resists_outliers_where_the_mean_does_not():
    rng = np.random.default_rng(2)
    points = np.vstack([rng.normal(size=(70, 3)), rng.normal(size=(30, 3)) + 100])
    assert np.linalg.norm(geometric_median(points)) < 2 < np.linalg.norm(points.mean(axis=0))


def test_start_at_a_point_that_is_not_the_median():
    points = np.array([[0, 0.0], [-3, 0], [-3, 0], [-3, 0], [-3, 0], [12, 0]])
    np.testing.assert_array_equal(points.mean(axis=0), points[0])
    np.testing.assert_allclose(geometric_median(points), [-3, 0], atol=1e-3)


def test_one_point_and_coincident_points():
    np.testing.assert_array_equal(geometric_median([[1.0, 2, 3]]), [1, 2, 3])
    np.testing.assert_allclose(geometric_median(np.ones((5, 3))), 1)


def test_no_point():
    with pytest.raises(ValueError, match="points"):
        geometric_median(np.zeros((0, 3)))
