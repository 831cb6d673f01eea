import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from sonoservo.systems.needle import Insertion, InsertionParameters, OperatorHand, Push
from sonoservo.systems.needle.hand import SPEED, appended


def make_insertion(pushes, **changes):
    values = {"bend_radius": 0.15, "tremor": 1e-4, **changes}
    hand = InsertionParameters(start=0.0, pushes=pushes, ramp=0.25, entry=[0.0, 0.0, 0.0], **values)
    return Insertion(hand, np.random.default_rng(3))


def drive(targets, **changes):
    """Drive through (time, target) pairs; the insertion, and the needles seen on the way."""
    hand = OperatorHand(make_insertion=lambda pushes: make_insertion(pushes, **changes))
    simulator = Simulator(hand)
    context = simulator.get_mutable_context()
    port = hand.GetInputPort("needle_target")
    seen, times = [], np.arange(0, 12, 1 / 20)
    for time in times:
        port.FixValue(context, next(t for start, t in reversed(targets) if start <= time))
        simulator.AdvanceTo(time)
        seen.append(hand.GetOutputPort("needle").Eval(context))
    return hand.insertion(context), times, seen


def test_what_is_recorded_moves_the_needle_in_the_same_way():
    rng = np.random.default_rng(0)
    targets = [
        (time, [rng.uniform(-0.005, 0.08), rng.uniform(-6, 6), rng.uniform(-1, 1), 0.1])
        for time in np.arange(0, 12, 0.4)
    ]
    insertion, times, seen = drive(targets)
    again = make_insertion(insertion.parameters.pushes)
    assert sum(map(bool, seen)) > 100
    for time, needle in zip(times, seen, strict=True):
        np.testing.assert_allclose(again.needle(time).shaft, needle.shaft, rtol=0, atol=1e-12)


def test_it_goes_where_it_is_wanted_and_not_beyond():
    insertion, times, seen = drive([(0.0, [0.05, 1.0, 0, 0])])
    depths = np.array([needle.length for needle in seen])
    assert depths.max() < 0.05 + 5e-4  # tremor
    assert np.diff(depths).max() * 20 < SPEED + 0.02  # tremor moves it besides
    assert depths[times > 5].mean() == pytest.approx(0.05, abs=5e-5)
    assert sum(push.duration * push.turning_deg for push in insertion.parameters.pushes) == (
        pytest.approx(np.rad2deg(1.0))
    )


def test_only_a_needle_that_is_outside_is_aimed():
    insertion, times, seen = drive(
        [(0, [0.02, 0, 0.0, 0]), (3, [0.02, 0, 1.0, 0]), (5, [-0.005, 0, 1.0, 0]),
         (8, [0.03, 0, 1.0, 0])]
    )  # fmt: skip
    first = {float(t): needle.shaft[1] for t, needle in zip(times, seen, strict=True) if needle}
    assert all(p[1] == 0 for t, p in first.items() if t < 7)
    late = [p for t, p in first.items() if t > 9]
    assert late
    for p in late:
        assert np.arctan2(p[1], p[0]) == pytest.approx(1.0)
    assert [push.azimuth_deg for push in insertion.parameters.pushes if push.aim] == [
        pytest.approx(np.rad2deg(1.0), abs=1e-6)
    ]


def test_a_straight_needle_is_aimed_anew_once_it_is_withdrawn_to_20_mm():
    straight = {"bend_radius": None, "tremor": 0.0, "initial_depth": 0.04}
    insertion, times, seen = drive(
        [(0, [0.04, 0, 0.0, 0]), (1, [0.04, 0, 0.3, 0]), (3, [0.015, 0, 0.3, 0]),
         (8, [0.05, 0, 0.3, 0])],
        **straight,
    )  # fmt: skip
    angles = np.array([np.arctan2(*needle.tip[1::-1]) for needle in seen])
    depths = np.array([needle.length for needle in seen])
    assert depths[times < 3] == pytest.approx(0.04)
    assert (angles[depths > 0.0205][: (times < 4).sum()] == 0).all()
    assert angles[times > 6] == pytest.approx(0.3)
    assert np.abs(np.diff(angles)).max() < np.deg2rad(30) / 20 * 1.6
    again = make_insertion(insertion.parameters.pushes, **straight)
    for time, needle in zip(times, seen, strict=True):
        np.testing.assert_allclose(again.needle(time).shaft, needle.shaft, rtol=0, atol=1e-12)


def test_equal_pushes_become_one():
    pushes = []
    for speed in (0.0, 0.0, 0.01, 0.01, 0.0):
        pushes = appended(pushes, Push(duration=0.25, speed=speed))
    assert [(push.duration, push.speed) for push in pushes] == [(0.5, 0), (0.5, 0.01), (0.25, 0)]
    assert len(appended(pushes, Push(duration=0.25, azimuth_deg=3.0))) == 4
