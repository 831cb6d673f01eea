"""What logs tell, on logs of runs that never happened."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_logs import build_insertion_log

from sonoservo.diagrams import FollowingScenario
from sonoservo.diagrams.studies.following.analysis import (
    centred,
    converged,
    found_after,
    lag,
    pooled,
    quantile,
    recovery_times,
    volumes,
)
from sonoservo.systems.needle import InsertionParameters, Push
from sonoservo.systems.robot import Move, PhantomMotionParameters


@pytest.fixture
def log():
    """5 mm/s from 2 to 12 s, 50 mm deep; all in the image, its tip at last below the probe."""
    made = build_insertion_log()
    return replace(made, visible_length=made.inserted_length)


def shifted(log, x, when):
    """The probe shifted by x along X while ``when`` holds."""
    X_WP = log.X_WP.copy()
    X_WP[:, 0, 3] += np.where(when, x, 0.0)
    return replace(log, X_WP=X_WP, measured_X_WP=X_WP)


def test_errors_and_features_by_volume(log):
    found = volumes(log, np.full(len(log.volume_time), 1e-3))
    assert found.enough.sum() == pytest.approx((20 - 6) / 0.3, abs=2)
    np.testing.assert_allclose(found.tip[found.enough], 0.5e-3, atol=1e-6)
    np.testing.assert_allclose(found.axis[found.enough], 0, atol=1e-6)
    assert np.isinf(found.tip[0])
    at_rest = log.volume_time > 12.5
    np.testing.assert_allclose(found.true[at_rest], 0, atol=1e-9)
    np.testing.assert_allclose(
        found.estimated[at_rest], [[0.3e-3, 0, 0]] * at_rest.sum(), atol=1e-9
    )
    np.testing.assert_allclose(found.p_PTip[at_rest], [[0, 0.04, 0]] * at_rest.sum(), atol=1e-9)


def test_a_needle_that_is_coasted_over_is_not_lost(log):
    length = len(log.volume_time)
    for mode, lost in (("coasting", 0), ("lost", 6), ("searching", 6)):
        modes = np.where(
            (log.volume_time > 14) & (log.volume_time < 15.8), mode, log.volume_estimate_mode
        )
        found = volumes(replace(log, volume_estimate_mode=modes), np.zeros(length))
        assert found.lost.sum() == pytest.approx(lost, abs=1)
        # Before it was found it was not lost either.
        assert not found.lost[log.volume_time < 13].any()


def test_a_volume_without_an_estimate_and_a_run_that_failed_are_infinitely_wrong(log):
    mode = np.where(log.volume_time > 14, "searching", log.volume_estimate_mode)
    tip = np.where(log.volume_time[:, np.newaxis] > 14, np.nan, log.volume_estimate_tip)
    blind = replace(log, volume_estimate_tip=tip, volume_estimate_mode=mode)
    runs = [
        SimpleNamespace(volumes=volumes(each, np.zeros(len(each.volume_time))))
        for each in (log, blind)
    ]
    all_of_them = pooled(runs, 0, lambda v: v.tip)
    count = int(runs[0].volumes.enough.sum())
    assert len(all_of_them) == 2 * count
    assert np.isinf(all_of_them).sum() == (log.volume_time > 14).sum()
    with_failure = pooled(runs, 1, lambda v: v.tip)
    assert len(with_failure) == 3 * count
    assert quantile(with_failure, 0.3) == pytest.approx(0.5e-3)
    assert quantile(with_failure, 0.95) == np.inf
    assert quantile([], 0.5) is None


def test_how_much_was_in_view_when_the_needle_was_found(log):
    ((visible, inserted),) = found_after(log)
    assert visible == inserted == pytest.approx(10e-3, abs=1.6e-3)
    wrong = replace(log, volume_estimate_tip=log.volume_estimate_tip + np.array([0, 0.02, 0]))
    assert found_after(wrong) == [(np.inf, np.inf)]


def test_a_second_insertion_is_looked_at_by_itself(log):
    away = (log.time > 13) & (log.time < 15)
    visible = np.where(away, 0.5e-3, log.visible_length)  # not quite out
    searching = (log.volume_time > 13) & (log.volume_time < 17)
    mode = np.where(searching, "searching", log.volume_estimate_mode)
    twice = replace(log, visible_length=visible, volume_estimate_mode=mode)
    (first, _), (second, _) = found_after(twice)
    assert first == pytest.approx(10e-3, abs=1.6e-3)
    assert second == pytest.approx(50e-3)


def test_centred_only_while_tracked_and_in_line(log):
    good = centred(log)
    assert not good[log.time < 11].any()
    assert good[log.time > 12].all()
    assert converged(log)
    assert not converged(shifted(log, 2.1e-3, log.time > 19.5))
    turned = replace(log, needle_entry=log.needle_entry + np.array([0, 0.01, 0]))
    assert not converged(turned)
    assert converged(turned, straight=False)
    assert not converged(replace(log, estimate_mode=np.full(len(log.time), "coasting")))


def test_time_until_the_needle_is_centred_again(log):
    moves = [Move(start=start, duration=0.5) for start in (13.0, 15.0, 17.0, 30.0)]
    scenario = FollowingScenario(phantom_motion=PhantomMotionParameters(moves=moves))
    # Off until 13.9 s; for less than half a second near 15.7 s only; for good.
    off = (log.time > 13) & (log.time < 13.9)
    off |= (log.time > 15) & (abs(log.time - 15.7) > 0.2)
    first, *others = recovery_times(shifted(log, 5e-3, off), scenario)
    assert first == pytest.approx(0.4, abs=1 / 16)
    assert others == [np.inf, np.inf]


def test_lag_is_that_at_the_end_of_the_last_push(log):
    pushes = [Push(duration=5.0, speed=0.005), Push(duration=5.0, speed=0.005)]
    scenario = FollowingScenario(hand=InsertionParameters(start=3.0, pushes=pushes))
    behind = shifted(log, -0.05, log.time >= 0)
    assert lag(behind, scenario) == pytest.approx(np.mean([0.045, 0.05]), abs=2e-3)
    assert np.isnan(lag(log, replace(scenario, hand=replace(scenario.hand, start=15.0))))
