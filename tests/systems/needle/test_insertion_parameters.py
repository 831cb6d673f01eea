"""Insertions through a template, and what they share with a hand's."""

import numpy as np
import pytest
from bicycle_model import BicyclePath

from sonoservo.systems.needle import FeedParameters, Insertion, InsertionParameters, Push

BEVEL = {"bend_radius": 1.6, "bend_radius_spread": 0.8, "start": 0.0}
BEVEL |= {"bend_angle_spread_deg": 2.0, "bend_roll_spread_deg": 180.0}


def make(seed=1, **changes):
    parameters = InsertionParameters(**{**BEVEL, "feed": FeedParameters(), **changes})
    return Insertion(parameters, np.random.default_rng(seed))


def closed_form(path):
    return BicyclePath(
        radius=path.radius, angle=path.angle, plane=path.roll, rotations=path.rotations
    )


def test_the_needle_follows_its_path_and_stops_at_its_depth():
    insertion = make(rotations=[0.06])
    needle = insertion.needle(5.0)
    entry = insertion.parameters.entry
    # Along X of T; beside is -Y, up is Z.
    shaft = (needle.shaft - entry)[:, [2, 1, 0]] * [1, -1, 1]
    lead = insertion.parameters.feed.lead
    assert shaft[-1, 2] == pytest.approx(0.05 + lead)
    assert shaft[0, 2] == pytest.approx(-0.01, rel=1e-2)
    inside = shaft[shaft[:, 2] >= 0]
    expected = closed_form(insertion.path).position(inside[:, 2])
    np.testing.assert_allclose(inside, expected, atol=1e-12)
    assert insertion.depth(1e3) == pytest.approx(0.14 + lead)
    assert insertion.end == pytest.approx(14.0)


def test_frame_of_the_insertion_runs_along_the_tissue_and_looks_down():
    X_TI = make(entry=[-0.07, 0.0, -0.03]).X_TI
    np.testing.assert_allclose(X_TI.rotation().matrix()[:, 2], [1, 0, 0])
    np.testing.assert_allclose(X_TI.rotation().matrix()[:, 1], [0, 0, -1])
    np.testing.assert_allclose(X_TI.translation(), [-0.07, 0.0, -0.03])


def test_draws_are_within_their_ranges_and_fill_them():
    insertions = [make(seed, entry_spread=[0.0, 2e-3, 2e-3]) for seed in range(200)]
    radii = np.array([each.path.radius for each in insertions])
    angles = np.rad2deg([each.path.angle for each in insertions])
    rolls = np.rad2deg([each.path.roll for each in insertions])
    assert radii.min() >= 0.8
    assert radii.max() <= 2.4
    assert np.mean(radii) == pytest.approx(1.6, abs=0.1)
    assert np.abs(angles).max() <= 2.0
    assert np.std(angles) == pytest.approx(2 / np.sqrt(3), rel=0.1)
    assert np.std(rolls) == pytest.approx(180 / np.sqrt(3), rel=0.1)
    offsets = np.array([each.needle(0.0).position(0.01) for each in insertions])
    spread = np.std(offsets - insertions[0].parameters.entry, axis=0)
    expected = np.array([0, 2e-3, 2e-3]) / np.sqrt(3)
    np.testing.assert_allclose(spread, expected, rtol=0.1, atol=1e-5)


def test_a_straight_needle_can_be_fed():
    feed = FeedParameters(depth=0.05, lead=0.002)
    straight = InsertionParameters(feed=feed, start=0.0, dip_deg=30.0)
    needle = Insertion(straight, np.random.default_rng(1)).needle(100.0)
    assert needle.length == pytest.approx(0.05 + 0.002 + 0.01)
    direction = (needle.tip - needle.shaft[0]) / needle.length
    np.testing.assert_allclose(direction, [np.cos(np.pi / 6), 0, -0.5], atol=1e-12)


def test_a_hand_pushes_an_uneven_path_with_rotations_too():
    pushes = [Push(duration=8, speed=1e-2), Push(), Push(duration=4, speed=-1e-2)]
    insertion = make(
        feed=None, pushes=pushes, rotations=[0.03], curvature_wander=0.2,
        bend_radius=0.3, bend_radius_spread=0.1,
    )  # fmt: skip
    deep, back = insertion.needle(8.75), insertion.needle(20.0)
    assert deep.length == pytest.approx(0.08, rel=1e-3)
    assert back.length == pytest.approx(0.04, rel=1e-3)
    # Withdrawn, the needle lies on the path that it has cut.
    s = np.linspace(0, 0.039, 14)
    np.testing.assert_allclose(back.position(s), deep.position(s), atol=5e-6)  # of their chords
    assert insertion.path.wander.std() > 0.05
    path = insertion.path.positions(np.linspace(0, 0.08, 41))
    shaft = (deep.shaft - insertion.parameters.entry)[:, [0, 2, 1]] * [1, 1, -1]
    np.testing.assert_allclose(shaft, path, atol=1e-9)


def test_later_pushes_change_nothing_before_them():
    def pushed(*pushes):
        parameters = InsertionParameters(**{**BEVEL, "curvature_wander": 0.2, "pushes": pushes})
        return Insertion(parameters, np.random.default_rng(3))

    push = Push(duration=4, speed=1e-2)
    before, after = pushed(push), pushed(push, Push(duration=6, speed=1e-2))
    for time in (1.0, 2.5, 4.0):
        np.testing.assert_array_equal(before.needle(time).shaft, after.needle(time).shaft)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotations": [0.2]}, "within the insertion"),
        ({"rotations": [0.06, 0.06]}, "ascending order"),
        ({"bend_radius": 0.84}, "bend_radius: 0.84 .* after bend_radius_spread is subtracted"),
        ({"gauge": 19}, "gauge: 19"),
        ({"entry": [0.0, 0.0]}, "entry: .* three coordinates"),
        ({"feed": None, "dip_deg": 91.0}, "dip_deg: 91.0"),
        ({"pushes": [Push()]}, "pushes: .* a template .* has none"),
        ({"tremor": 1e-4}, "tremor: .* a template .* has none"),
        ({"bend_radius": None}, "bend_radius_spread: .* a straight needle"),
    ],
)
def test_bad_values_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        InsertionParameters(**{**BEVEL, "feed": FeedParameters(), **changes})


def test_a_path_that_turns_back_before_the_feed_ends_is_refused():
    with pytest.raises(ValueError, match=r"feed.depth: 0.14 .* the path reaches"):
        make(bend_radius=0.1, bend_radius_spread=0.0)


def test_rotations_are_not_where_they_were_planned_and_draw_no_other_number():
    planned, real = (
        make(seed=4, rotations=[0.06], **changes).path
        for changes in ({}, {"rotation_depth_spread": 2e-3, "rotation_angle_spread_deg": 10.0})
    )
    assert 0 < abs(real.rotations[0] - 0.06) <= 2e-3
    assert 0 < abs(real.turn_errors[0]) <= np.deg2rad(10)
    distances = np.linspace(0, 0.14, 60)
    before = distances < 0.055
    a, b = (path.positions(distances) for path in (planned, real))
    np.testing.assert_allclose(a[before], b[before], atol=1e-12)
    assert np.linalg.norm(a[-1] - b[-1]) > 0.1e-3


def test_the_plane_of_the_bend_drifts_at_a_constant_rate():
    steady = make(seed=6).path
    path = make(seed=6, bend_drift_spread_deg=30.0).path
    assert 0 < abs(path.twist) <= np.deg2rad(30) / 0.1
    bends = np.diff(path.positions(np.linspace(0, 0.14, 8)), n=2, axis=0)[:, 1:]
    angles = np.unwrap(np.arctan2(bends[:, 1], bends[:, 0]))
    np.testing.assert_allclose(np.diff(angles) / 0.02, path.twist, rtol=0.1)
    assert path.roll == steady.roll
    assert path.radius == steady.radius
