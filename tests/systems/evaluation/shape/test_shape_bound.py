import numpy as np
import pytest

from sonoservo.systems.evaluation.shape.shape_metrics import TrueBend, deflection_bound

DEPTHS = np.array([0.07, 0.14])


def test_a_straight_fit_s_bound_is_that_of_regression():
    # Radius and wander known: a line through noisy points, extrapolated.
    seen = np.linspace(0, 0.06, 61)
    true = TrueBend(radius=1.5, angle=0.0, rotations=(), radius_std=1e-9, angle_std=10.0)
    found = deflection_bound(true, seen, 0.1e-3, DEPTHS)
    spread = np.sum((seen - seen.mean()) ** 2)
    expected = 0.1e-3 * np.sqrt(1 / 61 + (DEPTHS - seen.mean()) ** 2 / spread)
    np.testing.assert_allclose(found, expected, rtol=1e-2)


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
