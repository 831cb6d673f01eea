from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from synthetic_logs import build_log
from synthetic_volumes import GEOMETRY

from sonoservo.diagrams.studies.robustness.runs import as_in_probe
from sonoservo.systems.evaluation import estimate_errors, features, summarize
from sonoservo.systems.evaluation.run_errors import (
    consistency,
    curve_deviations,
    deviation,
    inside_stated,
    needle_speed,
)
from sonoservo.systems.signals import NeedleCurve

coordinate = st.floats(-0.2, 0.2)
point = st.tuples(coordinate, coordinate, coordinate)
angle = st.floats(-3, 3)


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
    assert np.nanmax(np.abs(estimate_errors(whole).axis)) < np.deg2rad(0.05)


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


VOLUMES, LENGTH, SPEED = 4000, 0.05, 8e-3
KINDS = ("tip", "axis", "velocity")
SEEN = (
    "tip", "entry", "velocity", "tip_covariance", "direction_covariance", "velocity_covariance",
)  # fmt: skip


def draw_log(dip_deg, stated=1.0, depth_error=0.0):
    """Log of a needle that advances, with errors drawn from known covariances.

    Deviations are stated `stated` times as large. The depth of the tip is wrong by `depth_error` in
    m besides, in every volume.
    """
    rng = np.random.default_rng(3)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    covariance = rotation @ np.diag([1e-6, 4e-6, 0.25e-6]) @ rotation.T
    dip = np.deg2rad(dip_deg)
    direction = np.array([np.cos(dip), 0.0, -np.sin(dip)])
    tip = np.array([0.05, 0.0, -0.04])
    tips = rng.multivariate_normal([*tip[:2], tip[2] + depth_error], covariance, VOLUMES)
    aside = np.stack([[-direction[2], 0, direction[0]], [0.0, 1.0, 0.0]])
    turns = 0.01 * rng.normal(size=(VOLUMES, 2))
    turned = direction + turns @ aside
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    time = np.array([0.0, 1.0, 2.0])
    tip_then = tip + SPEED * np.outer(time - 1.0, direction)
    X_WP = np.eye(4)
    X_WP[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    many = np.ones((VOLUMES, 1, 1))
    return build_log(
        3,
        VOLUMES,
        time=time,
        X_WP=np.tile(X_WP, (3, 1, 1)),
        measured_X_WP=np.tile(X_WP, (3, 1, 1)),
        needle_tip=tip_then,
        needle_points=np.linspace(tip_then - LENGTH * direction, tip_then, 9, axis=1),
        volume_estimate_time=np.ones(VOLUMES),
        volume_estimate_tip=tips,
        volume_estimate_entry=tips - LENGTH * turned,
        volume_estimate_velocity=SPEED * direction + 1e-3 * rng.normal(size=(VOLUMES, 3)),
        volume_estimate_tip_covariance=stated**2 * many * covariance,
        volume_estimate_direction_covariance=stated**2 * many * (1e-4 * aside.T @ aside),
        volume_estimate_velocity_covariance=stated**2 * many * (1e-6 * np.eye(3)),
    )


def test_an_error_in_depth_counts_only_with_the_depth_and_backwards_is_outside():
    log = draw_log(20, depth_error=0.02)
    assert np.mean(inside_stated(log)["tip"]) == 0
    assert np.mean(inside_stated(log, across_depth=True)["tip"]) == pytest.approx(0.95, abs=0.012)
    backwards = 2 * log.volume_estimate_tip - log.volume_estimate_entry
    turned = replace(log, volume_estimate_entry=backwards)
    assert not np.any(inside_stated(turned)["axis"])
    assert np.nanmin(estimate_errors(turned).axis) > 3.0


@pytest.mark.parametrize("turn_deg", [4, 90])
def test_an_error_of_the_probe_s_pose_does_not_count_in_the_probe(turn_deg):
    """What is measured is turned about the vertical, with all that is stated."""
    log = draw_log(20)
    turn = RotationMatrix.MakeZRotation(np.deg2rad(turn_deg)).matrix()
    shown = {f"volume_estimate_{name}": getattr(log, f"volume_estimate_{name}") for name in SEEN}
    turned = {
        name: turn @ each @ turn.T if each.ndim == 3 else each @ turn.T
        for name, each in shown.items()
    }
    measured = log.X_WP.copy()
    measured[:, :3, :3] = turn @ measured[:, :3, :3]
    wrong = replace(log, measured_X_WP=measured, **turned)
    for name in KINDS:
        seen = inside_stated(as_in_probe(wrong))[name]
        assert np.mean(seen) == pytest.approx(0.95, abs=0.012), name
    assert np.mean(inside_stated(wrong)["axis"]) < 0.1


def test_nothing_stated_is_neither_inside_nor_outside(insertion_log):
    for values in inside_stated(insertion_log).values():
        assert set(values) == {None}
    known = np.ones(len(insertion_log.volume_time), bool)
    nothing = {"nees": None, "within_95": None}
    assert consistency(insertion_log, known) == dict.fromkeys(KINDS, nothing)


@pytest.mark.parametrize(
    # chi-squared: P(x <= 7.81 / 4) for three degrees of freedom, P(x <= 5.99 / 4) for two
    ("stated", "nees", "within", "axis"),
    [(1.0, 1.0, 0.95, 0.95), (0.5, 4.0, 0.418, 0.527)],
)
def test_a_summary_has_the_share_and_the_size_of_squared_errors(stated, nees, within, axis):
    judged = np.arange(VOLUMES) < VOLUMES // 2
    figures = consistency(draw_log(20, stated), judged)
    for name, expected in (("tip", within), ("axis", axis), ("velocity", within)):
        assert figures[name]["within_95"] == pytest.approx(expected, abs=0.03)
    assert figures["tip"]["nees"] == pytest.approx(nees, rel=0.1)


DEPTH = 0.05


def line(start, stop, y=DEPTH, order=9):
    """Points along X, in P."""
    x = np.linspace(start, stop, order)
    return np.stack([x, np.full(order, y), np.zeros(order)], axis=1)


def arc(radius, length, count=9):
    s = np.linspace(0, length, count) / radius
    return np.stack([radius * np.sin(s) - 0.03, DEPTH - radius * (1 - np.cos(s)), 0 * s], axis=1)


@pytest.mark.parametrize("tip", [0.015, 0.02, 0.022])
def test_at_the_tip_it_is_the_tip_s_error(tip):
    estimate = NeedleCurve(line(-0.02, tip, order=2))
    assert deviation(line(-0.02, 0.02), estimate, GEOMETRY) == pytest.approx(abs(tip - 0.02))


def test_what_is_before_the_estimated_entry_or_outside_the_image_does_not_count():
    estimate = NeedleCurve(line(-0.02, 0.02, order=2))
    assert deviation(line(-0.2, 0.02), estimate, GEOMETRY) < 0.3e-3
    bent = line(-0.2, 0.02, order=201)
    bent[:120, 1] += 0.05 * (1 - np.arange(120) / 120)
    outside = NeedleCurve(line(-0.5, 0.02, order=2))
    assert not GEOMETRY.contains(bent[:120]).any()
    assert deviation(bent, outside, GEOMETRY) < 0.3e-3
    assert np.isnan(deviation(line(-0.9, -0.8), estimate, GEOMETRY))


def test_a_chord_misses_an_arc_by_its_sagitta():
    radius, length = 0.15, 0.06
    ends = NeedleCurve(arc(radius, length)[[0, -1]])
    sagitta = radius * (1 - np.cos(length / radius / 2))
    assert deviation(arc(radius, length), ends, GEOMETRY) == pytest.approx(sagitta, rel=0.02)
    parabola = NeedleCurve(arc(radius, length, 3))
    assert deviation(arc(radius, length), parabola, GEOMETRY) < 0.05 * sagitta


def test_of_a_log_in_the_probe_s_frame_at_the_estimate_s_time(make_log):
    """The needle sinks at 1 cm/s and the probe with it; the estimate is late but dated."""
    time = np.arange(0, 1, 1 / 32)
    X_WP = np.tile(np.eye(4), (len(time), 1, 1))
    X_WP[:, 1, 3] = 1e-2 * time
    sinking = np.stack([0 * time, 1e-2 * time, 0 * time], axis=1)[:, np.newaxis]
    estimates = np.stack(
        [line(-0.02, 0.02, order=3) + np.array([0, 1e-2 * t, 0]) for t in (0.3, 0.6, 0.8)]
    )
    estimates[1, :, 1] += 0.5e-3
    estimates[2] = np.nan
    log = make_log(
        len(time),
        3,
        time=time,
        X_WP=X_WP,
        needle_points=line(-0.02, 0.02) + sinking,
        volume_estimate_time=np.array([0.3, 0.6, 0.8]),
        volume_estimate_points=estimates,
    )
    np.testing.assert_allclose(curve_deviations(log, GEOMETRY), [0, 0.5e-3, np.nan], atol=1e-6)
