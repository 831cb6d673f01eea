import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.evaluation import ShapeLog, read_log
from sonoservo.systems.evaluation.log import write_log
from sonoservo.systems.evaluation.shape.shape_metrics import (
    TrueBend,
    cross_section_errors,
    deflection_bound,
    prediction,
    shape_coverage,
    shape_errors,
    summarize_shape,
    tracked_to_the_end,
)
from sonoservo.systems.signals import NeedleShape

DEPTH = np.linspace(0, 0.1, 101)


def straight(angle, plane=0.0):
    u = DEPTH * np.tan(angle)
    return np.column_stack([u * np.cos(plane), u * np.sin(plane), DEPTH])


def log_of(measured, true):
    n = len(DEPTH)
    return ShapeLog.from_rows(
        [
            {
                "depth": DEPTH[k],
                "measured": measured[k],
                "image_s": 1e-3,
                "estimate_s": 2e-3,
                **({"reason": "no echo"} if np.isnan(measured[k, 0]) else {}),
            }
            for k in range(n)
        ],
        lambda depth: true,
    )


def spread(deviation, n=4000, angle=0.0):
    """Straight paths whose angle is normal about ``angle``."""
    angles = angle + deviation * np.random.default_rng(0).normal(size=n)
    return NeedleShape(
        parameters=np.column_stack([np.full(n, 1e6), angles, np.zeros(n)]),
        origins=np.zeros((n, 2)), weights=np.full(n, 1 / n), origin_variance=1e-12,
        rotations=(), depth=0.1, observed=0.05, X_WI=RigidTransform(), time=0.0,
    )  # fmt: skip


def test_errors_of_a_turned_line_are_those_of_a_triangle():
    # Equation 8: the area of the triangle between the lines, 0.1 m high and 1 mm wide.
    true = straight(np.arctan(0.02), 0.4)
    predicted = straight(np.arctan(0.01), 0.4)[:, :2]
    errors = shape_errors(true, predicted)
    assert errors.tip == pytest.approx(1e-3)
    assert errors.shape == pytest.approx(0.5 * 0.1 * 1e-3)
    assert errors.largest == pytest.approx(1e-3)
    aside = shape_errors(straight(0.1), straight(0.1)[:, :2] + [0, 2e-3])
    assert aside.tip < 1e-9
    assert aside.largest == pytest.approx(2e-3)


def test_tip_and_shape_are_covered_in_95_percent_of_what_is_possible():
    shape = spread(0.01, n=400)
    draws = 0.01 * np.random.default_rng(1).normal(size=200)
    covered = [shape_coverage(shape, straight(each)) for each in draws]
    for name in ("tip", "shape"):
        assert 0.90 <= np.mean([each[name] for each in covered]) <= 0.99


def test_a_needle_that_is_left_or_lost_was_not_followed():
    true = straight(0.02)
    measured = true + np.array([1e-4, 0, 0])
    assert tracked_to_the_end(log_of(measured, true))
    assert np.allclose(cross_section_errors(log_of(measured, true)), 1e-4)
    lost = measured.copy()
    lost[-1] = np.nan
    assert not tracked_to_the_end(log_of(lost, true))
    off = measured.copy()
    off[50, 0] += 3e-3
    assert not tracked_to_the_end(log_of(off, true))


def test_summary_sums_up_and_the_file_holds_the_rows(tmp_path):
    true = straight(0.02)
    measured = true + np.array([1e-4, 0, 0])
    measured[3] = np.nan
    log = log_of(measured, true)
    summary = summarize_shape(log, spread(0.001, angle=0.02))
    assert summary["tracking"]["found"] == 100
    assert summary["tracking"]["error_mm"]["median"] == pytest.approx(0.1)
    assert summary["compute_ms"]["total"]["median"] == pytest.approx(3.0)
    figures = summary["prediction"]
    assert figures == prediction(log, spread(0.001, angle=0.02))
    assert figures["tip_error_true_mm"] < 0.02
    assert figures["tip_error_measured_mm"] == pytest.approx(0.1, abs=0.02)
    assert figures["tip_std_mm"] == pytest.approx(0.1, rel=0.05)
    read = read_log(write_log(tmp_path / "log.npz", log), ShapeLog)
    np.testing.assert_array_equal(read.measured, log.measured)
    assert read.reason[3] == "no echo"
    assert summarize_shape(read, None)["tracking"] == summary["tracking"]


DEPTHS = np.array([0.07, 0.14])


def test_the_best_linear_estimate_attains_it():
    rng = np.random.default_rng(0)
    true = TrueBend(radius=1.5, angle=0.0, rotations=())
    seen = np.arange(0, 0.0601, 1e-3)
    # u = x + v theta + v^2 / 2 kappa, with normal theta and kappa.
    scale = np.array([0.1, 0.0873, 0.6 / 1.5**2])
    design, end = (
        np.column_stack([np.ones_like(v), v, v**2 / 2]) * scale for v in (seen, DEPTHS[-1:])
    )
    errors = []
    for _ in range(400):
        unknown = rng.normal(size=3)
        u = design @ unknown + 0.1e-3 * rng.normal(size=len(seen))
        fit = np.linalg.solve(design.T @ design / 0.1e-3**2 + np.eye(3), design.T @ u / 0.1e-3**2)
        errors.append((end @ (fit - unknown))[0])
    found = deflection_bound(true, seen, 0.1e-3, DEPTHS)[-1]
    assert np.std(errors) == pytest.approx(found, rel=0.1)
