from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.evaluation.metrics import summarize
from sonoservo.systems.evaluation.run_errors import estimate_errors, features, needle_speed

coordinate = st.floats(-0.2, 0.2)
point = st.tuples(coordinate, coordinate, coordinate)
angle = st.floats(-3, 3)


def test_a_reversed_needle_is_half_a_turn_wrong(insertion_log):
    log = replace(
        insertion_log,
        volume_estimate_tip=insertion_log.volume_estimate_entry,
        volume_estimate_entry=insertion_log.volume_estimate_tip,
    )
    assert np.nanmin(estimate_errors(log).axis) == pytest.approx(np.pi)


def test_a_bent_needle_is_judged_from_where_it_is_seen(insertion_log):
    # An arc of radius 0.2 m; the estimate is its chord from the middle on.
    angles = np.linspace(0, 0.5, 9)
    arc = 0.2 * np.stack([np.sin(angles), 0 * angles, 1 - np.cos(angles)], axis=1)
    rows = np.isfinite(insertion_log.needle_tip).all(axis=1)
    log = replace(
        insertion_log,
        needle_points=np.where(rows[:, np.newaxis, np.newaxis], arc, np.nan),
        needle_tip=np.where(rows[:, np.newaxis], arc[-1], np.nan),
        volume_estimate_tip=np.tile(arc[-1], (len(insertion_log.volume_time), 1)),
        volume_estimate_entry=np.tile(arc[4], (len(insertion_log.volume_time), 1)),
    )
    errors = estimate_errors(log).axis
    assert np.isfinite(errors).sum() > 40
    # Points of the true needle are looked at every half per cent.
    assert np.nanmax(errors) < np.deg2rad(0.05)
    whole = replace(log, volume_estimate_entry=np.tile(arc[0], (len(log.volume_time), 1)))
    np.testing.assert_allclose(
        np.nanmax(np.abs(estimate_errors(whole).axis)), 0.0, atol=np.deg2rad(0.05)
    )


def test_truth_is_taken_at_the_time_of_the_estimate(insertion_log):
    # Estimates that hold 0.1 s later and say where the tip then is are right.
    later = insertion_log.volume_estimate_time + 0.1
    length = np.clip(5e-3 * (later - 2), 0, 50e-3)
    tip = insertion_log.volume_estimate_entry + length[:, np.newaxis] * [1, 0, 0]
    log = replace(insertion_log, volume_estimate_time=later, volume_estimate_tip=tip)
    assert summarize(log)["tracking"]["tip_error_mm"]["max"] == pytest.approx(0.5)


def test_error_in_the_probe_is_free_of_errors_of_the_pose(insertion_log):
    log = insertion_log
    X_PC = RigidTransform(RollPitchYaw(0.01, -0.02, 0.01), [1e-3, 2e-3, -1e-3]).GetAsMatrix4()
    said = X_PC @ np.linalg.inv(log.X_WP[0])
    X = log.X_WP[0] @ said
    wrong = replace(
        log,
        measured_X_WP=log.X_WP @ X_PC,
        volume_estimate_tip=log.volume_estimate_tip @ X[:3, :3].T + X[:3, 3],
    )
    before, after = estimate_errors(log), estimate_errors(wrong)
    np.testing.assert_allclose(before.in_probe, before.tip)
    np.testing.assert_allclose(after.in_probe, before.in_probe, atol=1e-12)
    assert np.nanmin(after.tip) > 1.5e-3
    unknown = replace(log, measured_X_WP=np.full_like(log.X_WP, np.nan))
    assert summarize(unknown)["tracking"]["tip_error_in_probe_mm"]["median"] is None


def test_speed_without_tremor(insertion_log):
    time = insertion_log.time
    rng = np.random.default_rng(0)
    tremor = 0.05e-3 * np.sin(2 * np.pi * 9.3 * time + rng.uniform(0, 6, (3, 1))).T
    log = replace(insertion_log, needle_tip=insertion_log.needle_tip + tremor)
    speed = needle_speed(log, window=1.0)
    assert np.isnan(speed[time <= 2]).all()
    np.testing.assert_allclose(speed[(time > 2.7) & (time < 11.5)], 5e-3, atol=0.1e-3)
    assert (speed[time > 12.6] < 0.1e-3).all()


@given(angle, angle, angle, point, point, st.floats(-1.5, 1.5), st.floats(-1.2, 1.2))
def test_features_do_not_depend_on_where_the_probe_is(roll, pitch, yaw, origin, tip, theta, dip):
    X_WP = RigidTransform(RollPitchYaw(roll, pitch, yaw), origin)
    k = np.array([np.cos(theta) * np.cos(dip), np.sin(dip), np.sin(theta) * np.cos(dip)])
    for sense in (1, -1):  # a direction and its opposite are one axis
        p_PEntry = np.array(tip) - 0.05 * sense * k
        result = features(
            X_WP.GetAsMatrix4()[np.newaxis],
            X_WP.multiply(np.array(tip))[np.newaxis],
            X_WP.multiply(p_PEntry)[np.newaxis],
        )
        np.testing.assert_allclose(result, [[tip[0], tip[2], theta]], atol=1e-9)
