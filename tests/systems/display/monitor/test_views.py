import numpy as np
import pytest

from sonoservo.systems.display.monitor.views import monitor_views
from sonoservo.systems.signals.needle_curve import NeedleCurve


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def views(volume, *points):
    return monitor_views(volume, NeedleCurve(points).transformed(volume.X_WP))


def test_without_a_needle_the_screen_has_the_probe_s_axes(make_volume):
    lateral, elevation = monitor_views(make_volume(zeros))
    p_P = np.array([[0.0, 0.0, 0.0], [0.01, 0.02, 0.03]])
    np.testing.assert_allclose(lateral.coordinates(p_P), p_P[:, :2], atol=1e-12)
    np.testing.assert_allclose(elevation.coordinates(p_P), p_P[:, [2, 1]], atol=1e-12)
    for view in (lateral, elevation):
        here, there = view.on_screen(view.coordinates(p_P))
        assert (there > here).all()  # to the right and down


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("angle", [0, 40, -40, 80])
def test_a_level_needle_is_at_its_own_coordinates(make_volume, sense, angle):
    turned = np.deg2rad(angle)
    along = np.array([np.cos(turned), 0.0, np.sin(turned)])
    across = np.array([-np.sin(turned), 0.0, np.cos(turned)])
    tip = 0.01 * along + 0.007 * across + [0.0, 0.05, 0.0]
    beam, level = views(make_volume(zeros), tip - sense * 0.03 * along, tip)
    np.testing.assert_allclose(beam.coordinates(tip), [0.01, 0.05], atol=1e-9)
    np.testing.assert_allclose(level.coordinates(tip), [0.01, 0.007], atol=1e-9)
    for view in (beam, level):  # whichever way the needle goes, X of the probe is on the right
        assert view.plane.X_PS.rotation().matrix()[0, 0] > 0
        np.testing.assert_allclose(view.in_probe(view.coordinates(tip)), tip, atol=1e-9)


def test_along_a_dipping_needle_zero_is_below_the_middle_of_the_probe(make_volume):
    _, level = views(make_volume(zeros), [-0.03, 0.02, 0.01], [0.03, 0.06, 0.01])
    np.testing.assert_allclose(level.coordinates(np.array([0.0, 0.04, 0.01])), [0, 0.01], atol=1e-9)
    length = np.hypot(0.03, 0.02)
    np.testing.assert_allclose(level.coordinates(np.array([0.03, 0.06, 0.01])), [length, 0.01])


@pytest.mark.parametrize("entry", [[-0.05, 0.03, 0.0], [-0.02, 0.01, 0.03], [0.0, 0.0, 0.0]])
def test_the_same_scale_for_both_and_nothing_beyond_the_place(make_volume, entry):
    volume = make_volume(zeros)
    scales = {each.scale for each in views(volume, entry, [0.01, 0.06, -0.01])}
    assert scales == {each.scale for each in monitor_views(volume)}
    assert len(scales) == 1
    for view in views(volume, entry, [0.01, 0.06, -0.01]):
        corners = np.array([[-1, -1], [1, 1]]) * [view.plane.width / 2, view.plane.height / 2]
        at = view.coordinates(view.plane.X_PS.translation()) + corners
        assert (at[0] >= view.window[0] - 1e-12).all()
        assert (at[1] <= view.window[1] + 1e-12).all()
        assert view.holds(np.array(at.mean(axis=0)))
        assert not view.holds(view.window[1] + 1e-6)
