import math

import numpy as np
import pytest

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.tracking.ransac import RansacParameters, ransac_axis

K = np.array([2, 1, -0.5]) / np.linalg.norm([2, 1, -0.5])
LENGTH = 0.06


def scene(rng, count, ratio, *, noise=0.4e-3, bend=0.0):
    """Candidates: a noisy needle from the origin along K, and clutter in a box around it."""
    inliers = round(count * ratio)
    a = rng.uniform(0, LENGTH, inliers)
    across = np.linalg.svd(K[np.newaxis])[2][1]
    needle = np.outer(a, K) + np.outer(bend * 4 * a * (LENGTH - a) / LENGTH, across)
    clutter = rng.uniform(-0.03, 0.03, (count - inliers, 3)) + LENGTH / 2 * K
    return np.vstack([needle + noise * rng.normal(size=(inliers, 3)), clutter])


def fit(points, rng, order=2, **options):
    return ransac_axis(points, np.ones(len(points)), order=order, rng=rng, **options)


def angle(found):
    return math.degrees(math.acos(min(abs(found.fit.axis.direction @ K), 1)))


@pytest.mark.parametrize("ratio", [1.0, 0.1])
def test_never_fails_on_a_straight_needle(ratio):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        assert angle(fit(scene(rng, 1500, ratio), rng)) < 1


def test_finds_a_bent_needle():
    truth = np.linspace(0.005, 0.055, 11)
    across = np.linalg.svd(K[np.newaxis])[2][1]
    expected = np.outer(truth, K) + np.outer(0.06 * 4 * truth * (LENGTH - truth) / LENGTH, across)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        found = fit(scene(rng, 800, 0.4, bend=0.06), rng, order=3)
        assert found.fit.axis.distance(expected).max() < 0.8e-3


def test_all_inliers_need_few_draws():
    rng = np.random.default_rng(0)
    found = fit(scene(rng, 500, 1.0, noise=0.05e-3), rng)
    assert found.trials < 20
    assert found.inliers.all()


@pytest.mark.parametrize("order", [2, 3])
def test_draws_are_capped_where_all_are_outliers(order):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (300, 3))
    found = fit(points, rng, order, parameters=RansacParameters(max_trials=50))
    assert isinstance(found, NotFound) or (found.trials <= 50 and found.inliers.mean() < 0.1)


def test_expected_direction_rejects_and_orients():
    rng = np.random.default_rng(0)
    points = scene(rng, 600, 0.4)
    found = fit(points, rng, direction=K, max_angle=math.radians(10))
    assert found.fit.axis.direction @ K > 0.99
    assert found.rejected > 0
    found = fit(points, rng, direction=-K, max_angle=math.radians(10))
    assert found.fit.axis.direction @ K < -0.99
    sideways = np.linalg.svd(K[np.newaxis])[2][1]
    line = np.outer(np.linspace(0, LENGTH, 100), K)
    found = fit(line, rng, direction=sideways, max_angle=math.radians(10))
    assert not found
    assert "none of 3000 samples" in found.reason


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.zeros((50, 3)), np.repeat([[0, 0, 0], [0, 0, 1e-3]], 20, axis=0)],
)
def test_degenerate_candidates(points, order):
    assert isinstance(fit(points, np.random.default_rng(0), order), NotFound)


@pytest.mark.parametrize("order", [2, 3])
def test_without_refits_the_winning_sample_remains(order):
    rng = np.random.default_rng(1)
    points = scene(rng, 800, 0.5, bend=0.03 if order == 3 else 0.0)
    found = fit(points, rng, order, parameters=RansacParameters(refits=0))
    # An axis through as many points as its order; those of a least-squares fit miss them all.
    assert np.sort(found.fit.axis.distance(points))[order - 1] < 1e-9
    refitted = fit(points, rng, order)
    assert np.sort(refitted.fit.axis.distance(points))[order - 1] > 1e-6
    a = found.fit.axis.abscissa(points[found.inliers])[[0, -1]]
    b = refitted.fit.axis.abscissa(points[refitted.inliers])[[0, -1]]
    spread = np.trace(refitted.fit.covariance(b, 20.0))
    assert spread < np.trace(found.fit.covariance(a, 20.0)) < 10 * spread
