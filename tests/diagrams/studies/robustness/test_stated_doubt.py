"""Truths inside the stated 95 %: errors drawn from what is stated are inside in 95 % of volumes."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RotationMatrix
from synthetic_logs import build_insertion_log, build_log

from sonoservo.diagrams.studies.robustness.runs import as_in_probe
from sonoservo.diagrams.studies.robustness.stated_doubt import inside_stated

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


@pytest.mark.parametrize("dip_deg", [5, 60])
@pytest.mark.parametrize("across_depth", [False, True])
def test_errors_as_stated_are_inside_in_95_percent(dip_deg, across_depth):
    inside = inside_stated(draw_log(dip_deg), across_depth=across_depth)
    assert set(inside) == set(KINDS)
    for name in KINDS:
        assert np.mean(inside[name]) == pytest.approx(0.95, abs=0.012), name


def test_doubt_that_is_too_small_shows():
    inside = inside_stated(draw_log(20, stated=0.5))
    # chi-squared: P(x <= 7.81 / 4) for three degrees of freedom, P(x <= 5.99 / 4) for two
    for name, expected in (("tip", 0.418), ("axis", 0.527), ("velocity", 0.418)):
        assert np.mean(inside[name]) == pytest.approx(expected, abs=0.025)


def test_an_error_in_depth_counts_only_with_the_depth():
    log = draw_log(20, depth_error=0.02)
    assert np.mean(inside_stated(log)["tip"]) == 0
    assert np.mean(inside_stated(log, across_depth=True)["tip"]) == pytest.approx(0.95, abs=0.012)


def test_an_axis_that_points_backwards_is_outside():
    log = draw_log(20)
    backwards = 2 * log.volume_estimate_tip - log.volume_estimate_entry
    inside = inside_stated(replace(log, volume_estimate_entry=backwards))
    assert not np.any(inside["axis"])
    assert np.mean(inside["tip"]) == pytest.approx(0.95, abs=0.012)


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


def test_nothing_stated_is_neither_inside_nor_outside():
    for values in inside_stated(build_insertion_log()).values():
        assert set(values) == {None}
