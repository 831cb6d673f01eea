"""Localization and tracking in volumes that owe nothing to the project's own renderer."""

import numpy as np
import pytest
from independent_images import Truth
from independent_study import (
    compare,
    quantiles,
)

from sonoservo.systems.signals.needle_curve import NeedleCurve

ALONG = np.linspace([0, 0.02, 0], [0.03, 0.03, 0.01], 60)


def truth(contrast=12.0):
    return Truth(ALONG[0], ALONG[-1], ALONG, np.full(len(ALONG), contrast), 0.5e-3, 0.03)


def test_the_true_curve_is_right():
    outcome = compare(truth(), NeedleCurve(ALONG[[0, -1]]), 1e-6 * np.eye(3))
    assert outcome.right
    assert outcome.tip == pytest.approx(0, abs=1e-9)
    assert outcome.tip_seen
    assert outcome.within_along
    assert outcome.within_across


def test_errors_are_told_apart():
    k = (ALONG[-1] - ALONG[0]) / np.linalg.norm(ALONG[-1] - ALONG[0])
    aside = np.cross(k, [0, 1, 0])
    aside *= 4e-3 / np.linalg.norm(aside)
    long = compare(truth(), NeedleCurve([ALONG[0], ALONG[-1] + 3e-3 * k]), 1e-6 * np.eye(3))
    assert long.along == pytest.approx(3e-3)
    assert long.across == pytest.approx(0, abs=1e-9)
    assert not long.within_along
    assert long.within_across
    beside = compare(truth(2.0), NeedleCurve(ALONG[[0, -1]] + aside), 1e-6 * np.eye(3))
    assert beside.across == pytest.approx(4e-3)
    assert not beside.right
    assert not beside.within_across
    assert not beside.tip_seen


def test_quantiles_are_those_of_the_magnitudes_in_mm():
    assert quantiles([-1e-3, 1e-3, 1e-3]) == "1.00, 1.00"
    assert quantiles([]) == "-, -"
