from itertools import pairwise

import numpy as np
from bicycle_model import BicyclePath
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

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
