import warnings

import numpy as np
import pytest

from sonoservo.systems.evaluation.statistics.intervals import (
    bootstrap_interval,
    proportion_interval,
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


@pytest.mark.parametrize("statistic", ["mean", "median"])
def test_the_interval_of_many_normal_values_is_that_of_theory(statistic):
    values = 3 + np.random.default_rng(1).normal(size=400)
    low, high = bootstrap_interval(values, statistic)
    width = {"mean": 1.0, "median": 1.2533}[statistic] * 2 * 1.96 / 20
    assert low < getattr(np, statistic)(values) < high
    assert high - low == pytest.approx(width, rel=0.2)
    assert bootstrap_interval(values, statistic) == (low, high)


def test_intervals_exist_for_few_and_equal_values_and_runs_without_a_value():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isnan(bootstrap_interval([1.0])).all()
        assert bootstrap_interval([2.0, 2.0, 2.0]) == (2.0, 2.0)
        assert bootstrap_interval([1.0, 2.0, np.nan, 4.0]) == bootstrap_interval([1.0, 2.0, 4.0])
        low, high = bootstrap_interval([1.0, 1.0, 1.0, 5.0], "median")
    assert 1 <= low <= high <= 5
