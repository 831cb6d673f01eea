import numpy as np
import pytest
from bicycle_model import BicyclePath
from hypothesis import assume, given
from hypothesis import strategies as st

from sonoservo.systems.needle.steered_path import (
    WANDER_STEP,
    SteeredPath,
    cut_arcs,
    draw_wander,
    positions,
)

R = 0.2
ANGLES = st.floats(-np.pi, np.pi)
RADII = st.floats(0.1, 3.0)
TILTS = st.floats(-0.3, 0.3)
ROTATIONS = st.lists(st.integers(5, 70), max_size=4, unique=True).map(
    lambda depths: tuple(1e-3 * each for each in sorted(depths))
)


@st.composite
def paths(draw):
    """Any path: tilted, turned at depths, in uneven tissue."""
    wander = draw(st.lists(st.floats(0.3, 2.0), max_size=40))
    return SteeredPath(
        radius=draw(RADII), roll=draw(ANGLES), angle=draw(TILTS), rotations=draw(ROTATIONS),
        wander=np.array(wander),
    )  # fmt: skip


@given(radius=st.floats(0.3, 5.0), roll=ANGLES, angle=TILTS, rotations=ROTATIONS)
def test_rotations_by_180_deg_give_the_closed_form_of_the_bicycle_model(
    radius, roll, angle, rotations
):
    assume(abs(angle) + 0.1 / radius < 1.2)
    found = SteeredPath(radius, roll, angle, rotations).positions(np.linspace(0, 0.1, 57))
    closed = BicyclePath(radius=radius, angle=angle, plane=roll, rotations=rotations)
    np.testing.assert_allclose(found[:, [1, 2, 0]], closed.position(found[:, 0]), atol=1e-9)


@given(path=paths(), depth=st.floats(1e-3, 0.05))
def test_length_down_to_a_depth_ends_there(path, depth):
    length = path.length_at(depth)
    assume(np.isfinite(length))
    assert path.positions(np.array([length]))[0, 0] == pytest.approx(depth, abs=1e-10)
    assert length >= depth - 1e-12


def test_a_path_that_turns_back_does_not_reach_its_depth():
    assert SteeredPath(0.1).length_at(0.11) == np.inf
    assert SteeredPath(0.1, rotations=(0.12,)).length_at(0.13) == np.inf
    assert SteeredPath(0.1).length_at(0.0) == 0.0


@given(path=paths(), first=st.floats(1e-3, 0.05), back=st.floats(0.0, 1.0))
def test_withdrawal_goes_back_along_the_path(path, first, back):
    depths = np.array([0.0, 0.5 * first, first, first * back])
    turns = np.array([0.0, 1.0, 2.0, 2.0])
    before, after = cut_arcs(depths[:3], turns[:3]), cut_arcs(depths, turns)
    s = np.linspace(0, first * back, 9)
    assert after[0].sum() == pytest.approx(first * back)
    if after[0].size:
        np.testing.assert_allclose(path.positions(s, after), path.positions(s, before), atol=1e-12)


@given(roll=ANGLES, angle=TILTS)
def test_first_direction_is_tilted_towards_the_bend(roll, angle):
    path = SteeredPath(R, roll, angle)
    wanted = [np.cos(angle), np.sin(angle) * np.cos(roll), np.sin(angle) * np.sin(roll)]
    np.testing.assert_allclose(path.direction, wanted, atol=1e-15)
    (ahead,) = path.positions(np.array([1e-6]))
    np.testing.assert_allclose(ahead / 1e-6, wanted, atol=1e-5)


def test_curvature_follows_the_wander_step_by_step():
    wander = np.array([1.0, 2.0, 0.5, 1.5])
    s = np.arange(0, 4.5) * WANDER_STEP
    angles = np.append(0.0, np.cumsum(wander)) * WANDER_STEP / R
    piece = wander / R
    x = np.append(0.0, np.cumsum(np.diff(np.sin(angles)) / piece))
    y = np.append(0.0, np.cumsum(-np.diff(np.cos(angles)) / piece))
    found = SteeredPath(R, wander=wander).positions(s)
    np.testing.assert_allclose(found[:, :2], np.stack([x, y], axis=1), atol=1e-15)


def test_wander_has_its_standard_deviation_and_a_longer_path_begins_alike():
    def draw(length, seed):
        return draw_wander(length, 0.1, 0.02, np.random.default_rng(seed))

    values = np.array([draw(0.1, seed) for seed in range(200)])
    assert values.mean() == pytest.approx(1.0, abs=0.01)
    assert values.std() == pytest.approx(0.1, rel=0.1)
    # The Gaussian's autocorrelation: exp(-d^2 / (4 sigma^2)).
    apart = round(0.02 / WANDER_STEP)
    correlation = np.mean((values[:, 0] - 1) * (values[:, apart] - 1)) / 0.01
    assert correlation == pytest.approx(np.exp(-0.25), abs=0.25)
    np.testing.assert_array_equal(draw(0.15, 7)[: len(values[7])], values[7])


def test_a_needle_turned_all_the_while_cuts_a_helix():
    # Constant curvature and torsion: a helix of radius k / (k^2 + t^2), pitch 2 pi t / (k^2 + t^2).
    curvature, torsion, length = 1 / R, 40.0, 0.2
    step = 1e-4
    s = np.arange(0, length + step / 2, step)
    lengths, angles = cut_arcs(s, torsion * s)
    found = positions(lengths, angles, np.full(len(lengths), curvature), s)
    squared = curvature**2 + torsion**2
    # Axis of the helix: along torsion d + curvature binormal, at the radius along the normal.
    axis = np.array([torsion, 0, curvature]) / np.sqrt(squared)
    centre = np.array([0, curvature / squared, 0])
    radial = found - centre - np.outer((found - centre) @ axis, axis)
    np.testing.assert_allclose(np.linalg.norm(radial, axis=1), curvature / squared, rtol=1e-3)
    np.testing.assert_allclose(found @ axis, s * torsion / np.sqrt(squared), atol=1e-7)
