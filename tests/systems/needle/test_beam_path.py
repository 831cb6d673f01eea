"""A needle that is an elastic beam, against closed forms and against the bicycle."""

import numpy as np
import pytest

from sonoservo.systems.needle import beam_path
from sonoservo.systems.needle.beam_path import BeamPath
from sonoservo.systems.needle.steered_path import SteeredPath

DISTANCES = np.linspace(0, 0.14, 71)


def test_a_short_beam_bends_as_a_cantilever_and_a_long_one_as_its_foundation_does(monkeypatch):
    h = 1e-3
    nodes = h * np.arange(101)
    # Without a foundation, a load at the tip bends it by x^2 (3 L - x) / (2 L^3).
    monkeypatch.setattr(beam_path, "FOUNDATION", 1e-6)
    cut = np.where(nodes < 0.1, 0.0, 1e-3)
    expected = 1e-3 * nodes**2 * (0.3 - nodes) / (2 * 0.1**3)
    np.testing.assert_allclose(beam_path._bent(cut, 0), expected, atol=2e-6)
    # A stiff one holds it on the cut.
    monkeypatch.setattr(beam_path, "FOUNDATION", 1e9)
    cut = 1e-3 * np.sin(20 * nodes) ** 2
    np.testing.assert_allclose(beam_path._bent(cut, 0), cut, atol=1e-5)


def test_its_radius_is_that_of_an_arc_as_far_aside():
    (_, tip) = BeamPath(0.8, 0.4, 0.0, (), 0.14).positions(np.array([0.0, 0.1]))
    assert np.hypot(*tip[1:]) == pytest.approx(0.1**2 / 1.6)
    assert np.arctan2(tip[2], tip[1]) == pytest.approx(0.4)


def test_the_shaft_moves_while_the_tip_goes_on_and_a_rotation_acts_late():
    path = BeamPath(1.0, 0.0, 0.0, (0.06,), 0.14)
    then, now = (path.positions(DISTANCES[: n + 1])[:, 1] for n in (30, 70))
    assert then[-1] - now[30] > 0.2e-3  # of a tip 2 mm aside
    bicycle = SteeredPath(1.0, rotations=(0.06,))
    assert now[-1] > 1.5 * bicycle.positions(DISTANCES)[-1, 1]
    straight = BeamPath(1.0, 0.0, 0.0, (), 0.14)
    np.testing.assert_array_equal(then, straight.positions(DISTANCES[:31])[:, 1])


def test_half_the_step_gives_the_same_path(monkeypatch):
    path = BeamPath(1.0, 0.0, 0.02, (0.06,), 0.14)
    coarse = path.positions(DISTANCES)
    monkeypatch.setattr(beam_path, "_STEP", 0.5e-3)
    beam_path._deflections.cache_clear()
    try:
        np.testing.assert_allclose(path.positions(DISTANCES), coarse, atol=0.1e-3)
    finally:
        beam_path._deflections.cache_clear()
