from itertools import pairwise

import numpy as np
import pytest
from bicycle_model import BicyclePath
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sonoservo.systems.signals.bicycle_paths import deflections

radii = st.floats(0.3, 5.0)
angles = st.floats(-0.15, 0.15)
turns = st.lists(st.integers(5, 135), max_size=4, unique=True).map(
    lambda depths: tuple(1e-3 * each for each in sorted(depths))
)


def path_by_solver(path, depths):
    """Referee: the bicycle model as an initial value problem in depth, piece by piece."""
    u, theta, sign = 0.0, path.angle, 1
    out = np.zeros(len(depths))
    edges = [0.0, *path.rotations, max(0.2, depths[-1])]
    for start, end in pairwise(edges):
        solution = solve_ivp(
            lambda v, y, s=sign: [np.tan(y[1]), s / (path.radius * np.cos(y[1]))],
            (start, end), [u, theta], rtol=1e-10, atol=1e-12, dense_output=True,
        )  # fmt: skip
        here = (depths >= start) & (depths <= end)
        if here.any():
            out[here] = solution.sol(depths[here])[0]
        u, theta = solution.y[:, -1]
        sign = -sign
    return out


@given(radius=radii, angle=angles, rotations=turns)
def test_closed_form_solves_the_differential_equation(radius, angle, rotations):
    path = BicyclePath(radius=radius, angle=angle, rotations=rotations)
    depths = np.linspace(0, 0.14, 29)
    assume(abs(angle) + 0.2 / radius < 1.2)
    assert np.allclose(path.deflection(depths), path_by_solver(path, depths), atol=1e-8)


def bicycle_step(state, distance, curvature):
    """Referee: x, y, z, theta, phi after one step along the path (eq. 2, corrected).

    Eq. 2 adds the bevel's angle beta to theta; in the bicycle model theta changes by
    alpha sin(beta) / l per step, that is by alpha / R. It also swaps sin(phi) and cos(phi).
    """
    _, _, _, theta, phi = state
    sine, cosine = np.sin(theta), np.cos(theta)
    change = [sine * np.cos(phi), sine * np.sin(phi), cosine, curvature, 0.0]
    return state + distance * np.array(change)


def test_steps_of_equation_2_converge_to_the_closed_form():
    path = BicyclePath(radius=0.9, angle=0.03, plane=2.0, rotations=(0.05, 0.09))
    errors = []
    for step in (1e-3, 1e-4):
        state = np.array([0, 0, 0, path.angle, path.plane])
        while state[2] < 0.14:
            turned = sum(state[2] > each for each in path.rotations)
            state = bicycle_step(state, step, (-1) ** turned / path.radius)
        errors.append(np.linalg.norm(state[:3] - path.position(state[2])))
    assert errors[1] < 1.5e-5
    assert errors[1] < 0.2 * errors[0]


def test_an_arc_as_the_paper_prints_its_circle():
    # Eq. 3 with the centre at u_c = R cos(theta), v_c = -R sin(theta): the lower half circle.
    path = BicyclePath(radius=1.5, angle=0.04)
    v = np.linspace(0, 0.14, 15)
    u_c, v_c = 1.5 * np.cos(0.04), -1.5 * np.sin(0.04)
    assert np.allclose(path.deflection(v), u_c - np.sqrt(1.5**2 - (v - v_c) ** 2), atol=1e-12)
    assert np.gradient(path.deflection(v), v)[0] == pytest.approx(np.tan(0.04), rel=0.1)


@given(radius=radii, angle=angles)
def test_two_rotations_at_one_depth_apart_return_the_curvature(radius, angle):
    v = np.linspace(0, 0.1, 11)
    close = BicyclePath(radius=radius, angle=angle, rotations=(0.05, 0.05 + 1e-9))
    assert np.allclose(
        close.deflection(v), BicyclePath(radius=radius, angle=angle).deflection(v), atol=1e-9
    )


def test_many_paths_at_once_are_the_paths_one_by_one():
    depths, rotations = np.linspace(0, 0.14, 8), (0.06,)
    parameters = np.array([[1.0, 0.02], [0.5, -0.03]])
    both = deflections(parameters, depths, np.array(rotations))
    for row, (curvature, sine) in zip(both, parameters, strict=True):
        path = BicyclePath(radius=1 / curvature, angle=np.arcsin(sine), rotations=rotations)
        assert np.allclose(row, path.deflection(depths))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radius": 0.0}, "radius"),
        ({"radius": -1.0}, "radius"),
        ({"angle": 2.0}, "angle"),
        ({"rotations": (0.06, 0.04)}, "ascending order"),
        ({"rotations": (0.0,)}, "above 0"),
    ],
)
def test_bad_paths_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        BicyclePath(**{"radius": 1.0, **changes})


def test_a_path_that_turns_back_has_no_deflection_further_on():
    path = BicyclePath(radius=0.1)
    with pytest.raises(ValueError, match="reaches"):
        path.deflection(0.11)
