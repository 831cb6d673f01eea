import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonoservo.systems.needle.bicycle_model import BicyclePath
from sonoservo.systems.needle.steered_path import cut_arcs, positions

R = 0.2
ANGLES = st.floats(-np.pi, np.pi)


@given(turn=ANGLES, distance=st.floats(0, 0.3))
def test_one_arc_is_a_circle(turn, distance):
    (found,) = positions(np.array([0.1]), np.array([turn]), 1 / R, np.array([distance]))
    along, aside = R * np.sin(distance / R), R * (1 - np.cos(distance / R))
    wanted = [along, aside * np.cos(turn), aside * np.sin(turn)]
    np.testing.assert_allclose(found, wanted, atol=1e-15)


@given(turn=ANGLES)
def test_a_bevel_turned_by_180_deg_cuts_the_path_of_the_bicycle_model(turn):
    path = BicyclePath(radius=R, plane=turn, rotations=(0.03,))
    first = R * np.arcsin(0.03 / R)  # length of the arc down to that depth
    s = np.linspace(0, 0.1, 23)
    found = positions(np.array([first, 0.07]), np.array([turn, turn + np.pi]), 1 / R, s)
    np.testing.assert_allclose(found[:, [1, 2, 0]], path.along(s), atol=1e-15)


def test_a_needle_turned_all_the_while_cuts_a_helix():
    # Constant curvature and torsion: a helix of radius k / (k^2 + t^2), pitch 2 pi t / (k^2 + t^2).
    curvature, torsion, length = 1 / R, 40.0, 0.2
    step = 1e-4
    s = np.arange(0, length + step / 2, step)
    lengths, angles = cut_arcs(s, torsion * s)
    found = positions(lengths, angles, curvature, s)
    squared = curvature**2 + torsion**2
    # Axis of the helix: along torsion d + curvature binormal, at the radius along the normal.
    axis = np.array([torsion, 0, curvature]) / np.sqrt(squared)
    centre = np.array([0, curvature / squared, 0])
    radial = found - centre - np.outer((found - centre) @ axis, axis)
    np.testing.assert_allclose(np.linalg.norm(radial, axis=1), curvature / squared, rtol=1e-3)
    np.testing.assert_allclose(found @ axis, s * torsion / np.sqrt(squared), atol=1e-7)


def test_a_withdrawn_needle_keeps_the_path_that_it_goes_back_on():
    depths = np.array([0, 0.02, 0.05, 0.03, 0.03, 0.06])
    turns = np.array([0, 0.0, 0.0, 0.0, 2.0, 2.0])
    lengths, angles = cut_arcs(depths[:4], turns[:4])
    np.testing.assert_allclose(lengths, [0.03])
    np.testing.assert_allclose(angles, [0.0])
    lengths, angles = cut_arcs(depths, turns)
    np.testing.assert_allclose(lengths, [0.03, 0.03])
    np.testing.assert_allclose(angles, [0.0, 2.0])


def test_outside_there_is_no_path():
    lengths, _ = cut_arcs(np.array([0, 0.02, -0.005]), np.zeros(3))
    assert lengths.size == 0
    lengths, angles = cut_arcs(np.array([0, 0.02, -0.005, 0.01]), np.array([0, 0, 1.0, 1.0]))
    assert lengths.sum() == pytest.approx(0.01)
    np.testing.assert_allclose(angles, [1.0])
