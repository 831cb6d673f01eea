"""Displacement of the tissue by probe and needle, against closed forms and integrals."""

import numpy as np
import pytest

from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    Displacements,
    displace,
    displace_points,
    displacement_limit,
    frame_field,
)

DEPTH, RADIUS = 4e-3, 33e-3
CONTACT = np.sqrt(DEPTH * RADIUS)
SHAFT = [[-0.06, 0, -0.04], [0, 0, -0.04]]


def field(depth=DEPTH, drag=0.0, hole=0.0, shaft=SHAFT):
    shaft = np.array([shaft], dtype=float)
    return Displacements(
        contacts=np.zeros((1, 2)),
        depths=np.array([depth]),
        radii=np.array([CONTACT]),
        shafts=shaft,
        counts=np.array([shaft.shape[1]]),
        drags=np.array([drag]),
        drag_reach=8e-3,
        hole=hole,
        deepest=depth,
        widest_push=abs(drag) + np.sqrt(hole),
    )


def displacement(points, **changes):
    points = np.array(points, dtype=float)
    return displace_points(points, field(**changes), 0, True) - points


def test_surface_is_that_of_hertz_inside_and_outside_the_contact():
    r = CONTACT * np.array([0.0, 0.3, 0.9, 0.999, 1.1, 2.0, 6.0])
    down = -displacement(np.column_stack([r, 0 * r, 0 * r - 1e-12]))[:, 2]
    share = np.minimum(CONTACT / np.maximum(r, 1e-12), 1)
    outside = np.arcsin(share) * (2 - (r / CONTACT) ** 2)
    outside = DEPTH / np.pi * (outside + np.sqrt(np.maximum((r / CONTACT) ** 2 - 1, 0)))
    hertz = np.where(r <= CONTACT, DEPTH - r**2 / (2 * RADIUS), outside)  # Johnson 1985, eq. 3.42
    np.testing.assert_allclose(down, hertz, atol=2e-6)


def test_interior_is_the_sum_of_boussinesqs_point_loads():
    n, m = 300, 60
    rings, angles = (np.arange(n) + 0.5) / n, 2 * np.pi * (np.arange(m) + 0.5) / m
    loads = np.repeat(rings * np.sqrt(1 - rings**2), m)
    # In units of the shear modulus: F = 16 G a^3 / 3 R.
    loads *= 16 * CONTACT**3 / (3 * RADIUS) / loads.sum()
    x = CONTACT * np.outer(rings, np.cos(angles)).ravel()
    y = CONTACT * np.outer(rings, np.sin(angles)).ravel()
    points = np.random.default_rng(0).uniform([-0.03, -0.03, -0.06], [0.03, 0.03, -0.004], (12, 3))
    got = displacement(points)
    for point, moved in zip(points, got, strict=True):
        d, dx, dy = -point[2], point[0] - x, point[1] - y
        distance = np.sqrt(dx**2 + dy**2 + d**2)
        # Poisson's ratio is 1/2.
        per_load = loads / (4 * np.pi) * d / distance**3
        expected = [
            per_load @ dx,
            per_load @ dy,
            -(loads / (4 * np.pi) / distance + per_load * d).sum(),
        ]
        np.testing.assert_allclose(moved, expected, atol=2e-8)


@pytest.mark.parametrize("changes", [{}, {"depth": 0.0, "drag": 1e-3}, {"drag": 1e-3}])
def test_gradient_is_that_of_the_displacement_and_indentation_keeps_volumes(changes):
    own, F = field(**changes), np.empty((3, 3))
    low, high = [-0.07, -0.01, -0.05], [0.02, 0.01, -0.002]
    for point in np.random.default_rng(1).uniform(low, high, (20, 3)):
        displace(*point, frame_field(own, 0), True, F)
        steps = 1e-6 * np.eye(3)
        there, back = (displace_points(point + s * steps, own, 0, True) for s in (1, -1))
        np.testing.assert_allclose(F, ((there - back) / 2e-6).T, atol=1e-7)
        if "drag" not in changes:
            assert np.trace(F) == pytest.approx(3, abs=1e-9)


def test_tissue_gives_way_to_the_volume_of_the_needle():
    R = 0.6e-3
    r = np.array([0.01e-3, 0.3e-3, 1e-3, 4e-3])
    middle = [[-0.03, each, -0.04] for each in r]
    moved = displacement(middle, depth=0.0, hole=R**2)
    # An annulus keeps its area: the cylindrical cavity of radius R.
    np.testing.assert_allclose(moved[:, 1], np.sqrt(r**2 + R**2) - r, rtol=0.02)
    np.testing.assert_allclose(moved[:, [0, 2]], 0, atol=1e-6)
    # Beyond the tip, in front of the needle: the far field of a line of sources.
    points = np.array([[0.02, 0.015, -0.04], [0.01, -0.02, -0.03]])
    along = np.linspace(-0.06, 0, 4001)
    lines = np.column_stack([along, 0 * along, 0 * along - 0.04])
    away = points[:, np.newaxis] - lines
    sources = away / np.linalg.norm(away, axis=2, keepdims=True) ** 3
    expected = R**2 / 4 * np.trapezoid(sources, along, axis=1)
    np.testing.assert_allclose(displacement(points, depth=0.0, hole=R**2), expected, atol=2e-7)


def test_drag_is_along_the_needle_and_falls_with_the_distance_from_its_nearest_point():
    points = [[-0.03, 0, -0.04], [-0.03, 0.008, -0.04], [-0.03, 0, -0.056], [0.008, 0, -0.04]]
    moved = displacement(points, depth=0.0, drag=1e-3)
    np.testing.assert_allclose(moved[:, 0], 1e-3 * np.exp([0, -1, -2, -1]), rtol=1e-6)
    np.testing.assert_allclose(moved[:, 1:], 0, atol=1e-12)
    bent = [[-0.06, 0, -0.04], [-0.03, 0, -0.04], [-0.03, 0, -0.07]]
    moved = displacement([[-0.05, 0, -0.04], [-0.03, 0, -0.06]], depth=0.0, drag=1e-3, shaft=bent)
    np.testing.assert_allclose(moved, [[1e-3, 0, 0], [0, 0, -1e-3]], atol=1e-9)


def test_limit_of_the_displacement_holds_everywhere_and_is_close():
    own = field(drag=1e-3, hole=0.6e-3**2)
    points = np.random.default_rng(3).uniform([-0.06, -0.06, -0.08], [0.06, 0.06, 0], (4000, 3))
    moved = np.linalg.norm(displace_points(points, own, 0, True) - points, axis=1)
    limits = np.array([displacement_limit(*point, frame_field(own, 0)) for point in points])
    assert (moved < limits).all()
    pressed = field()._replace(counts=np.zeros(1, np.int64))
    moved = np.linalg.norm(displace_points(points, pressed, 0, True) - points, axis=1)
    limits = np.array([displacement_limit(*point, frame_field(pressed, 0)) for point in points])
    assert np.median(moved / limits) > 0.6
