from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.evaluation.metrics import summarize
from sonoservo.systems.evaluation.run_errors import (
    consistency,
    estimate_errors,
    features,
    needle_speed,
    normalized_squared_errors,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

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


def test_normalized_squared_errors_are_chi_squared():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    for rank in (3, 2):
        root[:, rank:] = 0
        errors = rng.normal(size=(20000, 3)) @ root.T
        covariances = np.tile(root @ root.T, (20000, 1, 1))
        squared = normalized_squared_errors(errors, covariances)
        assert squared.mean() == pytest.approx(rank, rel=0.03)
        assert squared.var() == pytest.approx(2 * rank, rel=0.1)
    errors[3] = covariances[5] = np.nan
    assert np.flatnonzero(np.isnan(normalized_squared_errors(errors, covariances))).tolist() == [
        3,
        5,
    ]


def test_direction_is_as_uncertain_as_its_ends():
    rng = np.random.default_rng(2)
    points = np.array([[0.0, 0, 0], [0.02, 0.01, 0], [0.04, 0.03, 0.01]])
    root = 2e-4 * rng.normal(size=(18, 18))
    stated = NeedleEstimate(
        TrackingMode.TRACKING, 0.0, NeedleCurve(points), np.zeros((3, 3)), root @ root.T
    ).direction_covariance
    drawn = points + (rng.normal(size=(50000, 18)) @ root.T)[:, :9].reshape(-1, 3, 3)
    directions = drawn[:, -1] - drawn[:, 0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(np.cov(directions.T), stated, atol=0.03 * np.abs(stated).max())


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_share_of_truth_inside_the_stated_doubt(insertion_log, factor):
    rng = np.random.default_rng(3)
    volumes = len(insertion_log.volume_time)
    known = np.isfinite(insertion_log.volume_estimate_tip[:, 0])
    length = np.clip(5e-3 * (insertion_log.volume_time - 2), 0, 50e-3)
    tip = np.stack([length, 0 * length, 0 * length - 0.04], axis=1)
    moves = insertion_log.volume_time < 12
    velocity = np.where(moves, 5e-3, 0.0)[:, np.newaxis] * [1, 0, 0]
    stated = {}
    for name in ("tip", "velocity", "direction"):
        across = np.diag([1.0, 1.0, 1.0]) if name != "direction" else np.diag([0.0, 1.0, 1.0])
        stated[name] = np.tile((factor * 1e-3) ** 2 * across, (volumes, 1, 1))
    shares = []
    for _ in range(20):
        drawn = 1e-3 * rng.normal(size=(3, volumes, 3))
        turned = np.array([1.0, 0, 0]) + drawn[2] * [0, 1, 1]
        estimate = tip + drawn[0]
        log = replace(
            insertion_log,
            volume_estimate_tip=estimate,
            volume_estimate_entry=estimate - 0.05 * turned,
            volume_estimate_velocity=velocity + drawn[1],
            **{f"volume_estimate_{name}_covariance": each for name, each in stated.items()},
        )
        figures = consistency(log, known & (np.abs(insertion_log.volume_time - 12) > 0.3))
        shares.append([figures[name]["within_95"] for name in ("tip", "axis", "velocity")])
    tip_share, axis_share, velocity_share = np.mean(shares, axis=0)
    if factor == 1:
        np.testing.assert_allclose([tip_share, axis_share, velocity_share], 0.95, atol=0.02)
    else:  # chi-squared with 3 and 2 degrees of freedom below a quarter of the 95 % limit
        np.testing.assert_allclose([tip_share, velocity_share], 0.42, atol=0.03)
        assert axis_share == pytest.approx(0.53, abs=0.03)


def test_no_stated_uncertainty_holds_an_axis_that_points_backwards(insertion_log):
    volumes = len(insertion_log.volume_time)
    shaft = insertion_log.volume_estimate_tip - insertion_log.volume_estimate_entry
    shares = []
    for sense in (1, -1):
        log = replace(
            insertion_log,
            volume_estimate_entry=insertion_log.volume_estimate_tip - sense * shaft,
            volume_estimate_direction_covariance=np.tile(
                1e-2 * np.diag([0.0, 1.0, 1.0]), (volumes, 1, 1)
            ),
        )
        shares.append(consistency(log, np.ones(volumes, bool))["axis"]["within_95"])
    assert shares == [1, 0]


def test_a_log_without_covariances_states_nothing(insertion_log):
    known = np.ones(len(insertion_log.volume_time), bool)
    nothing = {"nees": None, "within_95": None}
    assert consistency(insertion_log, known) == dict.fromkeys(("tip", "axis", "velocity"), nothing)
