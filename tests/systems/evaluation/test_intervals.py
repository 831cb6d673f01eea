import numpy as np
import pytest

from sonoservo.systems.evaluation.intervals import (
    UNBOUNDED,
    count_interval,
    proportion_interval,
    run_interval,
)


def test_a_proportion_has_wilson_s_interval():
    # 1 + z^2 / n and so on, by hand for 9 of 10.
    z, n, p = 1.959964, 10, 0.9
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert proportion_interval(9, 10) == pytest.approx((middle - half, middle + half), abs=1e-6)
    assert proportion_interval(0, 0) == (0, 1)
    low, high = proportion_interval(10, 10)
    assert 0.7 < low < 0.75
    assert high == pytest.approx(1)
    with pytest.raises(ValueError, match="successes"):
        proportion_interval(3, 2)


def median(values):
    return float(np.quantile(values, 0.5, method="inverted_cdf"))


def test_covers_the_truth_in_about_95_percent():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(20):
        runs = [level + 0.1 * rng.normal(size=30) for level in rng.normal(size=20)]
        low, high = run_interval(runs, np.mean)
        hits += low <= 0 <= high
    assert 16 <= hits <= 20  # resampling volumes instead of runs would give about 5


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_few_runs_tell_nothing_and_one_without_an_estimate_counts_as_infinite():
    assert run_interval(5 * [np.ones(1000)], median) == run_interval(np.ones(5)) == UNBOUNDED
    assert run_interval(6 * [np.ones(10)], median) == (1, 1)
    runs = [*(np.full(9, float(n)) for n in range(4)), *(2 * [np.full(9, np.inf)])]
    low, high = run_interval(runs, median)
    assert low < 2.5
    assert high == np.inf
    assert np.isnan(run_interval(6 * [np.array([1.0, np.nan])])).all()


@pytest.mark.parametrize(("count", "low", "high"), [(0, 0.0, 3.69), (5, 1.62, 11.67)])
def test_counts(count, low, high):
    np.testing.assert_allclose(count_interval(count), (low, high), atol=0.01)
