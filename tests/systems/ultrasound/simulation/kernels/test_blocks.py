"""Rays through curved bodies, and scatterers in them."""

import numpy as np
import pytest

from sonoservo.systems.signals import BodySurface
from sonoservo.systems.ultrasound.simulation.kernels.blocks import keep_inside, way_through

BALL = BodySurface([0.2, 0.2, 0.2], "ellipsoid")
LIMB = BodySurface([0.3, 0.12, 0.12], "cylinder")


def test_a_ray_meets_a_ball_where_pythagoras_says():
    down = np.array([0.0, 0.0, -1.0])
    enter, leave = way_through(np.array([0.06, 0.0, 0.01]), down, BALL.bounds)
    half = np.sqrt(0.1**2 - 0.06**2)
    assert (enter, leave) == (pytest.approx(0.11 - half), pytest.approx(0.11 + half))
    enter, leave = way_through(np.array([0.11, 0.0, 0.01]), down, BALL.bounds)
    assert leave < enter
    enter, leave = way_through(np.array([0.0, 0.0, -0.1]), down, BALL.bounds)
    assert (enter, leave) == (0.0, pytest.approx(0.1))


def test_a_ray_along_a_cylinder_leaves_it_at_its_end():
    along = np.array([1.0, 0.0, 0.0])
    inside, beside = np.array([-0.2, 0.03, -0.03]), np.array([-0.2, 0.05, -0.01])
    assert way_through(inside, along, LIMB.bounds) == pytest.approx((0.05, 0.35))
    enter, leave = way_through(beside, along, LIMB.bounds)
    assert leave < enter


@pytest.mark.parametrize("surface", [BALL, LIMB], ids=lambda each: each.shape)
def test_scatterers_outside_a_curved_body_are_left_out(surface):
    rng = np.random.default_rng(0)
    corner = [0.03, 0.03, -0.06]
    points = rng.uniform(0, 0.06, (3, 500)).astype(np.float32)
    chosen = np.arange(501, dtype=np.uint64)
    count = keep_inside(chosen, 500, *points, *corner, surface.bounds)
    expected = np.flatnonzero(surface.contains(points.T.astype(float) + corner))
    np.testing.assert_array_equal(chosen[:count], expected)
    assert 0 < count < 500
