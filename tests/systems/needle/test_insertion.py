import numpy as np
import pytest
from bicycle_model import BicyclePath
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.needle import Insertion, InsertionParameters, Push
from sonoservo.systems.needle.steered_path import SteeredPath


def make(**changes):
    return Insertion(InsertionParameters(**changes), np.random.default_rng(1))


def test_depth_follows_pushes_pauses_and_withdrawal():
    pushes = [Push(duration=4, speed=5e-3), Push(duration=2), Push(duration=3, speed=-4e-3)]
    insertion = make(start=1.0, pushes=pushes, ramp=0.5)
    assert insertion.depth(1.0) == 0
    assert insertion.depth(6.0) == pytest.approx(20e-3)
    assert insertion.depth(7.0) == pytest.approx(20e-3)
    assert insertion.depth(100.0) == pytest.approx(8e-3)
    assert insertion.end == pytest.approx(10.5)


@pytest.mark.parametrize(("out", "length"), [(3, 8e-3), (9, 0.0)])
def test_a_withdrawn_needle_leaves_a_track_to_its_deepest_point(out, length):
    pushes = [Push(duration=4, speed=5e-3), Push(duration=out, speed=-4e-3)]
    insertion = make(start=1.0, dip_deg=20.0, pushes=pushes, ramp=0.5)
    assert insertion.needle(4.0).track is None
    track = insertion.needle(100.0).track - insertion.entry
    np.testing.assert_allclose(
        track @ insertion.direction, [length, 20e-3], atol=1e-3
    )  # rounded by the ramp
    np.testing.assert_allclose(np.cross(track, insertion.direction), 0, atol=1e-12)


def test_speed_changes_within_the_ramp_and_never_jumps():
    insertion = make(start=1.0, pushes=[Push(duration=2, speed=10e-3)], ramp=0.4)
    times = np.arange(0.5, 4, 1e-3)
    speed = np.gradient([insertion.depth(t) for t in times], 1e-3)
    assert np.abs(np.gradient(speed, 1e-3)).max() <= 10e-3 / 0.4 * 1.01
    assert speed[np.searchsorted(times, 2.0)] == pytest.approx(10e-3, rel=1e-3)


def test_withdrawn_past_the_entry_the_needle_is_outside():
    entry = [-0.06, 0.01, -0.03]
    pushes = [Push(duration=1, speed=1e-2), Push(duration=2, speed=-1e-2)]
    insertion = make(entry=entry, azimuth_deg=90.0, pushes=pushes)
    outside = insertion.needle(20.0)
    assert not outside
    # 10 mm before the entry, aimed along +Y.
    tip, ahead = outside.aim
    np.testing.assert_allclose(tip, [-0.06, 0.0, -0.03], atol=1e-12)
    np.testing.assert_allclose(np.cross(ahead - tip, [0, 1, 0]), 0, atol=1e-12)
    assert (ahead - tip)[1] > 0
    X = RigidTransform(RollPitchYaw(0.1, 0.2, 0.3), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(outside.transformed(X).aim[0], X.multiply(tip))
    assert insertion.needle(2.0).aim is None


def test_a_needle_that_is_outside_can_be_put_in_elsewhere():
    pushes = [Push(duration=2, speed=1e-2), Push(duration=3, speed=-1e-2)]
    pushes.append(Push(duration=4, speed=1e-2, entry=[0.0, 0.03, -0.02]))
    insertion = make(pushes=pushes, entry=[-0.1, 0.0, -0.04])
    np.testing.assert_allclose(insertion.needle(2.5).shaft[0], [-0.1, 0.0, -0.04])
    assert not insertion.needle(6.0)
    np.testing.assert_allclose(insertion.needle(20.0).shaft[0], [0.0, 0.03, -0.02])
    assert insertion.depth(20.0) == pytest.approx(30e-3)
    pushes[1].duration = 1.0
    with pytest.raises(ValueError, match=r"pushes.2.entry: .* still 12.5 mm in the tissue"):
        make(pushes=pushes)


@given(
    azimuth=st.floats(-180, 180),
    dip=st.floats(-80, 80),
    roll=st.floats(-180, 180),
    radius=st.floats(0.1, 1.0),
)
def test_bent_shaft_lies_on_a_circle_and_has_the_pushed_length(azimuth, dip, roll, radius):
    angles = {"azimuth_deg": azimuth, "dip_deg": dip, "bend_roll_deg": roll}
    insertion = make(**angles, bend_radius=radius, pushes=[Push(duration=10, speed=6e-3)])
    needle = insertion.needle(30.0)
    first_step = needle.shaft[1] - needle.shaft[0]
    assert needle.length == pytest.approx(60e-3, rel=1e-4)
    assert first_step @ insertion.direction == pytest.approx(np.linalg.norm(first_step), rel=1e-3)
    assert insertion.direction[2] == pytest.approx(-np.sin(np.deg2rad(dip)))
    chord = np.linalg.norm(needle.tip - needle.shaft[0])
    assert chord == pytest.approx(2 * radius * np.sin(60e-3 / 2 / radius))


def test_tremor_has_the_stated_size_and_is_repeatable():
    changes = {"pushes": [Push(duration=5, speed=6e-3)], "tremor": 1e-4}
    times = np.arange(20, 60, 0.01)
    first = np.array([make(**changes).depth(t) for t in times[:5]])
    insertion = make(**changes)
    depths = np.array([insertion.depth(t) for t in times])
    assert np.std(depths) == pytest.approx(1e-4, rel=0.1)
    np.testing.assert_array_equal(first, depths[:5])


def test_directions_spread_within_the_stated_bounds():
    parameters = InsertionParameters(dip_deg=10.0, angle_spread_deg=3.0)
    drawn = [Insertion(parameters, np.random.default_rng(seed)).direction for seed in range(60)]
    dips = np.rad2deg(np.arcsin(-np.array(drawn)[:, 2]))
    assert 7 <= dips.min() < 8 < 12 < dips.max() <= 13


BENT = {"bend_radius": 0.15, "start": 0.0, "entry": [0.0, 0.0, 0.0]}


def test_a_needle_turned_half_way_in_follows_the_bicycle_model():
    push = Push(duration=5, speed=6e-3)
    insertion = make(**BENT, pushes=[push, Push(), Push(duration=2, turning_deg=90), Push(), push])
    # X_T runs along the insertion, Z_T up, towards which the needle bends at first.
    turned = 0.15 * np.sin(30e-3 / 0.15)  # depth along X_T after 30 mm of path
    s = np.linspace(0, 60e-3, 31)
    path = SteeredPath(0.15, rotations=(turned,)).positions(s)
    closed = BicyclePath(radius=0.15, rotations=(turned,)).position(path[:, 0])
    shaft = insertion.needle(60).shaft
    np.testing.assert_allclose(shaft[:, [0, 2]], path[:, :2], atol=1e-12)
    np.testing.assert_allclose(shaft[:, [2, 1, 0]], closed, atol=1e-12)


def test_a_needle_that_is_outside_can_be_aimed_anew():
    pushes = [Push(duration=2, speed=1e-2), Push(duration=4, speed=-1e-2)]
    again = Push(duration=6, speed=1e-2, azimuth_deg=90.0)
    insertion = make(pushes=[*pushes, again], dip_deg=10.0, entry=[0.0, 0.0, 0.0])
    assert insertion.direction_deg == (90.0, 10.0)
    dip = np.deg2rad(10)
    np.testing.assert_allclose(
        insertion.needle(30).tip, [0, 0.04 * np.cos(dip), -0.04 * np.sin(dip)], atol=1e-15
    )
    with pytest.raises(ValueError, match="pushes.1.azimuth_deg: 90.0 is not allowed"):
        make(pushes=[pushes[0], again])


def test_the_part_in_the_tissue_at_the_start_was_cut_before_the_needle_was_turned():
    push = Push(duration=5, speed=6e-3)
    turn = [Push(duration=2, turning_deg=60), Push(duration=1)]
    from_outside = make(**BENT, pushes=[push, Push(), *turn, push])
    from_inside = make(**BENT, initial_depth=30e-3, pushes=[*turn, push])
    s = np.linspace(0, 60e-3, 13)
    one, other = (each.needle(60).position(s) for each in (from_outside, from_inside))
    np.testing.assert_allclose(one, other, atol=5e-6)  # of their chords


def test_a_partly_withdrawn_needle_turns_about_its_entry():
    """30 deg at 30 deg/s: half way after 0.5 s, and there after 1 s."""
    pushes = [Push(duration=4, speed=1e-2), Push(duration=3, speed=-1e-2)]
    pushes += [Push(duration=2, azimuth_deg=30.0), Push(duration=3, speed=1e-2)]
    entry = [0.01, 0.02, -0.03]
    insertion = make(start=0.0, ramp=0.1, entry=entry, pushes=pushes)
    for time, azimuth_deg in ((6.9, 0.0), (7.5, 15.0), (8.0, 30.0), (11.5, 30.0)):
        needle = insertion.needle(time)
        np.testing.assert_allclose(needle.shaft[0], entry)
        direction = needle.curve.direction
        assert np.rad2deg(np.arctan2(direction[1], direction[0])) == pytest.approx(azimuth_deg)
    assert insertion.needle(8.5).length == pytest.approx(10e-3)
    assert insertion.needle(60).length == pytest.approx(40e-3)
    angles = [insertion._aim_at(t).azimuth_deg for t in np.linspace(6.9, 8.1, 400)]
    assert np.diff(angles).max() < 0.5  # it never jumps


@pytest.mark.parametrize(
    ("changes", "aim", "message"),
    [
        ({}, {"azimuth_deg": 60.0}, "azimuth_deg: 60.0 .* within 45 deg of the present direction"),
        ({"bend_radius": 0.2}, {"dip_deg": 5.0}, "dip_deg: 5.0 .* 15.0 mm in the tissue; withdraw"),
        ({"initial_depth": 0.01}, {"dip_deg": 5.0}, "dip_deg: 5.0 .* withdraw it to 20 mm"),
    ],
)
def test_a_needle_that_cannot_be_turned_in_the_tissue_is_refused(changes, aim, message):
    pushes = [Push(duration=2, speed=1e-2), Push(duration=1), Push(duration=1, speed=-5e-3)]
    with pytest.raises(ValueError, match=rf"pushes\.4\.{message}"):
        make(pushes=[*pushes, Push(duration=1), Push(duration=1, **aim)], **changes)


def test_the_shorter_way_round_is_taken_across_north():
    pushes = [Push(duration=1, azimuth_deg=-10.0)]
    insertion = make(start=0.0, azimuth_deg=350.0, initial_depth=0.01, pushes=pushes)
    np.testing.assert_allclose(
        insertion.needle(0.3).curve.direction, insertion.needle(9).curve.direction, atol=1e-12
    )


def test_a_bevelled_tip_bends_away_from_its_face():
    for roll_deg in (0.0, 90.0, 200.0):
        bent = make(**BENT, bend_roll_deg=roll_deg, initial_depth=0.04).needle(0.0)
        left, up = np.array([0, 1, 0]), np.array([0, 0, 1])
        face = np.cos(bent.roll) * up + np.sin(bent.roll) * left
        aside = bent.tip - bent.shaft[0]
        np.testing.assert_allclose(aside[1:] / np.linalg.norm(aside[1:]), -face[1:], atol=1e-9)
    turned_over = make(**BENT, initial_depth=0.04, rotations=[0.02]).needle(0.0)
    assert turned_over.roll == pytest.approx(2 * np.pi)
