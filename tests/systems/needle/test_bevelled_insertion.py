import numpy as np
import pytest

from sonoservo.systems.needle.bevelled_insertion import (
    BevelledInsertion,
    BevelledInsertionParameters,
)
from sonoservo.systems.needle.hand import Hand


def make(seed=1, **changes):
    return BevelledInsertion(BevelledInsertionParameters(**changes), np.random.default_rng(seed))


def test_the_needle_follows_its_path_and_stops_at_its_depth():
    insertion = make(entry_spread=0.0, rotations=[0.06])
    depths = np.linspace(0, 0.14, 29)
    # Chords of 0.5 mm are off an arc of 0.8 m by less than 0.1 um.
    assert np.allclose(insertion.position(depths), insertion.path.position(depths), atol=1e-7)
    needle = insertion.needle(5.0)
    assert insertion.X_TI.inverse().multiply(needle.tip)[2] == pytest.approx(0.052)
    assert insertion.depth(1e3) == pytest.approx(0.142)


def test_frame_of_the_insertion_runs_along_the_tissue_and_looks_down():
    R = make().X_TI.rotation().matrix()
    assert np.allclose(R[:, 2], [1, 0, 0])
    assert np.allclose(R[:, 1], [0, 0, -1])


def test_the_hand_takes_such_an_insertion():
    hand = Hand(insertion=make())
    context = hand.CreateDefaultContext()
    context.SetTime(3.0)
    needle = hand.GetOutputPort("needle").Eval(context)
    assert needle.length == pytest.approx(0.03 + 0.002 + 0.01, rel=1e-2)


def test_draws_are_within_their_ranges_and_fill_them():
    paths = [make(seed).path for seed in range(200)]
    radii = np.array([path.radius for path in paths])
    angles = np.rad2deg([path.angle for path in paths])
    assert radii.min() >= 0.8
    assert radii.max() <= 2.4
    assert np.mean(radii) == pytest.approx(1.6, abs=0.1)
    assert np.abs(angles).max() <= 2.0
    assert np.std(angles) == pytest.approx(2 / np.sqrt(3), rel=0.1)


def test_wander_has_the_stated_deviation_and_no_wander_is_the_model():
    depths = np.linspace(0.02, 0.12, 51)
    shares = []
    for seed in range(100):
        insertion = make(seed, curvature_wander=0.1, entry_spread=0.0, greatest_angle_deg=0.0)
        plane = insertion.path.plane
        u = insertion.position(depths)[:, :2] @ [np.cos(plane), np.sin(plane)]
        curvature = np.gradient(np.gradient(u, depths), depths)[2:-2]
        shares.append(curvature * insertion.path.radius)
    assert np.mean(shares) == pytest.approx(1.0, abs=0.04)
    assert np.std(shares) == pytest.approx(0.1, rel=0.25)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotations": [0.2]}, "within the insertion"),
        ({"rotations": [0.06, 0.06]}, "rising order"),
        ({"gauge": 19}, "gauge: 19"),
        ({"min_radius": 0.1}, "min_radius"),
        ({"min_radius": 1.0, "greatest_radius": 0.9}, "greatest_radius"),
        ({"greatest_angle_deg": 30.0}, "greatest_angle_deg"),
        ({"speed": 0.0}, "speed"),
    ],
)
def test_bad_values_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        BevelledInsertionParameters(**changes)
