import numpy as np
import pytest

from sonoservo.systems.display import slice_views
from sonoservo.systems.display.console.slices import beside, slice_pictures
from sonoservo.systems.signals import LineHypotheses, NeedleCurve

ENTRY, TIP = np.array([-0.03, 0.03, -0.02]), np.array([0.01, 0.05, 0.01])


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def ball_at_the_tip(p_P):
    return 200 * np.exp(-np.sum((p_P - TIP) ** 2, axis=-1) / (2 * 0.003**2))


def views(volume, *points):
    return slice_views(volume, NeedleCurve(points).transformed(volume.X_WP))


def pictures(volume, *points, **options):
    return slice_pictures(volume, NeedleCurve(points).transformed(volume.X_WP), **options)


def brightest(picture):
    """Coordinates in mm of the brightest place of a picture, as a page draws it."""
    grey = picture.grey.astype(float) ** 2
    rows, columns = grey.shape
    right = (grey.sum(axis=0) @ (np.arange(columns) + 0.5)) / grey.sum() / columns
    down = (grey.sum(axis=1) @ (np.arange(rows) + 0.5)) / grey.sum() / rows
    return np.array(picture.corner) + [right, down] * np.array(picture.size)


def test_without_a_needle_the_slices_have_the_probe_s_axes(make_volume):
    lateral, elevation = slice_views(make_volume(zeros))
    p_P = np.array([[0.0, 0.0, 0.0], [0.01, 0.02, 0.03]])
    np.testing.assert_allclose(lateral.coordinates(p_P), p_P[:, :2], atol=1e-12)
    np.testing.assert_allclose(elevation.coordinates(p_P), p_P[:, [2, 1]], atol=1e-12)
    shown = slice_pictures(make_volume(zeros))
    assert [each.axes for each in shown] == [("X", "depth"), ("Z", "depth")]
    assert all(not each.rails and not each.tip.size for each in shown)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("angle", [0, -40, 80])
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


def test_the_tip_is_where_its_echo_is(make_volume):
    for picture in pictures(make_volume(ball_at_the_tip), ENTRY, TIP):
        np.testing.assert_allclose(picture.tip, brightest(picture), atol=0.3)


def test_the_rails_run_beside_the_needle_and_follow_its_bend(make_volume):
    middle = 0.5 * (ENTRY + TIP) + [0.0, 0.004, 0.0]
    for points in ((ENTRY, TIP), (ENTRY, middle, TIP)):
        volume = make_volume(ball_at_the_tip)
        curve = NeedleCurve(points)
        for picture, view in zip(pictures(volume, *points), views(volume, *points), strict=True):
            needle = 1e3 * view.coordinates(curve.position(np.linspace(0, 1, 201)))
            for rail in picture.rails:
                apart = np.linalg.norm(rail[:, np.newaxis] - needle, axis=-1).min(axis=1)
                np.testing.assert_allclose(apart, 2.5, atol=0.05)
    left, right = beside(np.array([[0.0, 0.0], [1.0, 0.0]]), 2.0)
    np.testing.assert_allclose([left[0], right[0]], [[0, -2], [0, 2]])


def test_slices_beside_the_needle_show_what_is_there(make_volume):
    volume = make_volume(ball_at_the_tip)
    through = pictures(volume, ENTRY, TIP)
    near = pictures(volume, ENTRY, TIP, offsets=(0.001, 0.0))
    far = pictures(volume, ENTRY, TIP, offsets=(0.02, 0.02))
    assert [bool(each.rails) for each in (*through, *near, *far)] == [True] * 4 + [False] * 2
    assert near[0].grey.max() < through[0].grey.max()
    assert max(each.grey.max() for each in far) < 5
    assert len(pictures(volume, ENTRY + 1.0, TIP + 1.0)) < 2
    beside_it, through_it = slice_pictures(volume, None, (1.0, 0.0))
    assert beside_it is None
    assert through_it is not None


def test_a_line_that_is_followed_is_drawn_as_far_as_it_is_near_a_slice(make_volume):
    volume = make_volume(zeros)
    ends = np.array(
        [[[-0.02, 0.03, -0.01], [0.02, 0.03, 0.01]], [[0, 0.02, 0.02], [0, 0.04, 0.02]]]
    )
    ends = volume.X_WP.multiply(ends.reshape(-1, 3).T).T.reshape(-1, 2, 3)
    lines = LineHypotheses(
        time=0.0, ends=ends, probabilities=[0.5, 0.1], classes=np.eye(5)[[0, 2]],
        looks=np.zeros(2), looked=np.ones(2), numbers=np.arange(2),
    )  # fmt: skip
    lateral, elevation = slice_pictures(volume, lines=lines)
    ((name, drawn),) = lateral.lines  # the other is 20 mm beside it
    assert name == "needle"
    np.testing.assert_allclose(drawn, [[-6, 30], [6, 30]], atol=1e-6)  # 3 mm to either side
    assert [each for each, _ in elevation.lines] == ["needle", "riding"]
    np.testing.assert_allclose(elevation.lines[1][1], [[20, 20], [20, 40]], atol=1e-6)
