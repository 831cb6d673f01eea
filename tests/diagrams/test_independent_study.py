"""Localization and tracking in volumes that owe nothing to the project's own renderer."""

import numpy as np
import pytest
from independent_images import Truth, sequence_case, volume_case
from independent_study import compare

from sonoservo.diagrams import locate_in, track
from sonoservo.systems.signals import NeedleCurve

SHAPE = 84, 68, 52
ALONG = np.linspace([0, 0.02, 0], [0.03, 0.03, 0.01], 60)


def truth(contrast=12.0):
    return Truth(ALONG[0], ALONG[-1], ALONG, np.full(len(ALONG), contrast), 0.5e-3)


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


def test_clear_needles_are_located():
    outcomes = []
    for seed in range(100, 109):
        rng = np.random.default_rng([seed, 3])
        volume, truth = volume_case(rng, True, (), shape=SHAPE, level=20, dip=rng.uniform(0, 40))
        found = locate_in(volume)
        if found:
            outcomes.append(compare(truth, found.curve))
    # One needle ends in view on either side, so nothing tells its tip from its entry.
    assert sum(each.right and each.tip < 2e-3 for each in outcomes) >= 8
    assert all(each.right for each in outcomes)


@pytest.mark.parametrize("seed", [100, 101])
def test_no_needle_is_located_in_speckle(seed):
    volume, _ = volume_case(np.random.default_rng([seed, 4]), False, (), shape=SHAPE)
    assert not locate_in(volume)


def test_an_insertion_is_tracked():
    case = sequence_case(
        np.random.default_rng(120), True, (), shape=SHAPE, level=18, dip=20, speed=15e-3,
        withdraw=False, moving=False, max_volumes=24,
    )  # fmt: skip
    volumes, truths = zip(*case, strict=True)
    estimates = list(track(volumes))
    assert not any(bool(e) for e, true in zip(estimates, truths, strict=True) if true is None)
    outcome = compare(truths[-1], estimates[-1].curve, estimates[-1].tip_covariance)
    assert outcome.right
    assert outcome.tip < 2e-3
