"""Life of a track, with a filter that believes all it is told."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.control_point_filter import ControlPointFilter
from sonoservo.systems.tracking.innovation_gate import gate_distance
from sonoservo.systems.tracking.track import Track
from sonoservo.systems.tracking.track_lifecycle import TrackLifecycle
from sonoservo.systems.tracking.track_parameters import TrackParameters

STILL = RigidTransform()
NOTHING = {
    "detection": NotFound("nothing moved"),
    "measurement": NotFound("nothing seen"),
    "velocity": NotFound("not measured"),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Belief(Immutable):
    """A needle that rests, 1 mm uncertain."""

    time: float
    curve: NeedleCurve
    told: tuple = ()

    velocity = np.zeros((2, 3))
    covariance = 1e-6 * np.eye(12)

    def transformed(self, X):
        return dataclasses.replace(self, curve=self.curve.transformed(X))


class FakeFilter:
    """Believes the newest measurement, and notes what it was told."""

    orders = (2,)

    def start(self, measurement):
        return Belief(measurement.time, measurement.curve, ("start",))

    def predict(self, state, time):
        return dataclasses.replace(state, time=time)

    def update(self, state, measurement, velocity):
        told = tuple(type(each).__name__ for each in (measurement, velocity))
        curve = state.curve if measurement is None else measurement.curve
        return dataclasses.replace(state, curve=curve, told=told)


def lifecycle(anywhere=False, needle_filter=None, **parameters):
    return TrackLifecycle(
        order=2,
        parameters=TrackParameters(**parameters),
        needle_filter=needle_filter or FakeFilter(),
        anywhere=anywhere,
    )


def measurement(tip=0.03, time=0.0, y=0.0, entry=0.0):
    curve = NeedleCurve([[entry, y, 0], [tip, y, 0]])
    return NeedleMeasurement(curve, 1e-6 * np.eye(6), time, 100, 0.8)


def detection(x, time=0.0):
    at = np.array([x, 0, 0])
    return InsertionDetection(np.zeros(3), at, at, 1e-3, 6.0, time)


def tracked(life, time=0.0):
    return life.confirm(life.needle_filter.start(measurement(time=time)), time)


def test_detections_that_advance_start_a_track():
    life = lifecycle()
    track = life.without_needle(0.0)
    for x in (2e-3, 2.5e-3, 2e-3, 3.2e-3):
        track = life.initiate(track, detection(x, 1.0))
        assert not track
        assert track.reason == "something moved; the needle is not confirmed yet"
    started = life.initiate(track, detection(5e-3, 1.5))
    np.testing.assert_allclose(started.state.curve.control_points, [[2e-3, 0, 0], [5e-3, 0, 0]])
    assert started.mode == TrackingMode.SEARCHING
    assert not started.estimate
    assert not life.initiate(track, detection(30e-3, 1.5))


def test_a_needle_that_is_withdrawn_starts_no_track():
    life = lifecycle()
    track = life.without_needle(0.0)
    for x in (12e-3, 9e-3, 6e-3, 3e-3):
        track = life.initiate(track, detection(x, 1.0))
        assert not track
    started = life.initiate(track, detection(6e-3, 1.5))
    np.testing.assert_allclose(started.state.curve.control_points, [[3e-3, 0, 0], [6e-3, 0, 0]])


def test_the_prediction_says_what_is_known():
    life = lifecycle(seconds_between_searches=1.0)
    nothing = life.predict(life.without_needle(0.0, searched=0.5), 1.0, STILL)
    assert nothing.reason == "no needle has been detected"
    guess = life.initiate(life.initiate(life.without_needle(0.0), detection(2e-3)), detection(6e-3))
    guessed = life.predict(guess, 1.0, STILL)
    assert guessed.entry is None
    assert not guessed.everywhere
    track = dataclasses.replace(tracked(life), missed=2)
    expected = life.predict(track, 1.0, STILL)
    assert (expected.time, expected.missed, expected.everywhere) == (1.0, 2, False)
    np.testing.assert_array_equal(expected.entry, track.state.curve.entry)
    assert expected.covariance.shape == (6, 6)


def test_a_lost_needle_is_predicted_nowhere_and_expected_everywhere():
    life = lifecycle(anywhere=True)
    unseen = life.predict(life.without_needle(0.0), 1.0, STILL)
    assert unseen.everywhere
    assert unseen.curve is None
    assert unseen.order == 2
    lost = dataclasses.replace(tracked(life), mode=TrackingMode.LOST)
    expected = life.predict(lost, 5.0, STILL)
    assert expected.everywhere
    assert expected.time == 0.0
    assert expected.curve.chord == pytest.approx(0.03)


def test_a_track_in_the_probe_s_frame_is_carried_along():
    X = RigidTransform([0.0, 0.01, 0.0])
    track = tracked(lifecycle())
    assert track.seen_from(X) is track
    carried = dataclasses.replace(track, X_WP=STILL, first=track.state).seen_from(X)
    for state in (carried.state, carried.first):
        np.testing.assert_allclose(state.curve.tip, [0.03, 0.01, 0.0])
    assert carried.X_WP is X
    predicted = lifecycle().predict(dataclasses.replace(track, X_WP=STILL), 1.0, X)
    np.testing.assert_allclose(predicted.entry, [0.0, 0.01, 0.0])


def test_the_filter_is_told_what_is_believed():
    life = lifecycle()
    speed = VelocityMeasurement(np.zeros(3), np.eye(3), 0.9)
    track = life.next(
        tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.031, 0.9), "velocity": speed}
    )
    assert track.state.told == ("NeedleMeasurement", "VelocityMeasurement")
    assert (track.mode, track.time, track.since) == (TrackingMode.TRACKING, 0.9, 0.9)
    assert 0 < track.innovation < life.gate
    coasted = life.next(track, 1.3, **NOTHING | {"velocity": speed})
    assert coasted.state.told == ("NoneType", "VelocityMeasurement")
    assert (coasted.mode, coasted.time, coasted.since) == (TrackingMode.COASTING, 1.3, 0.9)
    assert coasted.innovation is None


def test_two_rejected_measurements_that_agree_start_anew():
    life = lifecycle()
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(y=0.02)})
    assert track.mode == TrackingMode.COASTING
    assert track.rejected is not None
    assert track.innovation > life.gate
    elsewhere = life.next(track, 1.3, **NOTHING | {"measurement": measurement(y=-0.02)})
    assert elsewhere.mode == TrackingMode.COASTING
    again = life.next(track, 1.3, **NOTHING | {"measurement": measurement(y=0.021)})
    assert again.mode == TrackingMode.TRACKING
    assert again.state.told == ("start",)
    assert again.rejected is None


def test_coast_lose_find_again_and_give_up():
    life = lifecycle(volumes_to_lose=2, seconds_to_give_up=3.0)
    track = tracked(life)
    modes = []
    for time in (1.0, 2.0, 3.0, 4.0):
        track = life.next(track, time, **NOTHING)
        modes.append(track.mode)
    assert modes == ["coasting", "lost", "lost", "searching"]


@pytest.mark.parametrize("before", ["lost", "nothing"])
def test_a_needle_that_was_found_is_tracked_once_others_confirm_it(before):
    life = lifecycle(volumes_to_follow=3, seconds_to_give_up=3.0)
    track = life.without_needle(0.0)
    if before == "lost":
        track = dataclasses.replace(tracked(life), mode=TrackingMode.LOST)
    mode = track.mode
    seen = {"measurement": measurement(y=0.1)}
    modes, everywhere = [], []
    for time in (1.0, 1.3, 1.6):
        everywhere.append(life.predict(track, time, STILL).everywhere)
        track = life.next(track, time, **NOTHING | seen)
        modes.append(track.mode)
    assert modes == [mode, mode, TrackingMode.TRACKING]
    assert everywhere == [True, False, False]
    np.testing.assert_allclose(track.estimate.curve.tip, [0.03, 0.1, 0.0])


@pytest.mark.parametrize(
    ("entry", "step", "followed"),
    [(0.0, 0.012, True), (0.0, 0.03, False), (0.006, 0.012, True), (0.0, -0.012, False)],
)
def test_a_needle_that_is_pushed_on_fast_is_confirmed(entry, step, followed):
    life = lifecycle(volumes_to_follow=3)
    track = life.without_needle(0.0)
    for n in range(3):
        moved = measurement(0.03 + n * step, 1.0 + 0.3 * n, entry=n * entry)
        track = life.next(track, moved.time, **NOTHING | {"measurement": moved})
    assert (track.mode == TrackingMode.TRACKING) is followed


def test_a_guess_that_is_not_confirmed_yields_to_a_search():
    life = lifecycle(volumes_to_confirm=2, seconds_between_searches=0.1)
    track, searched = life.without_needle(0.0), []
    for n in range(1, 12):
        seen = {"detection": detection(3e-3 * n, 0.3 * n)}
        expected = life.predict(track, 0.3 * n, STILL)
        searched.append(not isinstance(expected, NotFound) and expected.everywhere)
        track = life.next(track, 0.3 * n, **NOTHING | seen)
    assert sum(searched[3:]) >= 2


@pytest.mark.parametrize("then", ["nothing", "another needle"])
def test_a_needle_that_is_not_confirmed_is_forgotten(then):
    life = lifecycle(volumes_to_follow=2)
    lost = dataclasses.replace(tracked(life), mode=TrackingMode.LOST)
    once = life.next(lost, 1.0, **NOTHING | {"measurement": measurement(y=0.1)})
    assert once.reason == "a needle was found; it is not confirmed yet"
    np.testing.assert_allclose(once.estimate.curve.tip, [0.03, 0.0, 0.0])
    other = {"measurement": measurement(y=0.2)} if then == "another needle" else {}
    then_seen = life.next(once, 1.3, **NOTHING | other)
    assert then_seen.mode == TrackingMode.LOST
    assert then_seen.seen == len(other)


def test_the_whole_volume_is_searched_now_and_then_while_nothing_moves():
    life = lifecycle(seconds_between_searches=1.0)
    track, times = life.without_needle(0.0), []
    for time in np.arange(0, 3, 0.3):
        expected = life.predict(track, time, STILL)
        times += [time] if not isinstance(expected, NotFound) else []
        track = life.next(track, time, **NOTHING)
    np.testing.assert_allclose(times, [0.0, 1.2, 2.4])
    never = lifecycle(seconds_between_searches=0.0)
    waiting = never.next(never.without_needle(0.0), 0.3, **NOTHING)
    assert isinstance(never.predict(waiting, 99.0, STILL), NotFound)


def test_what_does_not_grow_is_given_up():
    life = lifecycle(grown_length=0.02, seconds_to_grow=3.0)
    for tip, kept in ((0.015, False), (0.021, True)):
        first = life.needle_filter.start(measurement(0.015))
        track = life.confirm(first, 0.0)
        for time in (0.1, 1.0, 2.0, 3.0, 3.2):
            seen = {"measurement": measurement(tip, time=time)}
            track = life.next(track, time, **NOTHING | seen)
        assert bool(track) is kept
        assert kept or track.reason == "what was found did not grow"


def test_a_measurement_nearby_is_the_same_needle_whatever_the_gate_says():
    life = lifecycle(gate=0.5, max_jump=4e-3)
    for y, mode in ((3.9e-3, TrackingMode.TRACKING), (4.1e-3, TrackingMode.COASTING)):
        after = life.next(tracked(life), 0.3, **NOTHING | {"measurement": measurement(y=y)})
        assert after.mode == mode
        assert after.innovation > life.gate
    assert after.reason.startswith("the measurement is")


def test_the_prediction_knows_for_how_long_the_tip_is_unseen():
    life = lifecycle()
    seen = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(time=1.0)})
    hidden = dataclasses.replace(measurement(time=1.5), tip_seen=False)
    track = life.next(seen, 1.5, **NOTHING | {"measurement": hidden})
    assert life.predict(track, 1.8, STILL).tip_unseen == pytest.approx(0.8)


def test_until_a_needle_has_grown_what_is_new_must_come():
    life = lifecycle(sure_length=0.02, seconds_to_be_sure=0.0, seconds_between_searches=0.1)
    nothing = life.predict(life.without_needle(0.0), 1.0, STILL)
    assert nothing.everywhere
    assert nothing.must_come
    resting = lifecycle(anywhere=True)
    assert not resting.predict(resting.without_needle(0.0), 1.0, STILL).must_come
    grown = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.03)})
    ended = life.next(grown, 99.0, **NOTHING)
    assert not ended
    assert not life.predict(ended, 99.5, STILL).must_come
    moved = dataclasses.replace(tracked(life), mode=TrackingMode.SEARCHING)
    assert life.predict(moved, 1.0, STILL).must_come
    assert not life.predict(dataclasses.replace(moved, grown=True), 1.0, STILL).must_come
    short = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.019)})
    lost = dataclasses.replace(short, mode=TrackingMode.LOST)
    assert life.predict(lost, 2.0, STILL).must_come
    assert not life.predict(dataclasses.replace(lost, grown=True), 2.0, STILL).must_come


def test_what_was_followed_for_a_moment_may_be_no_needle():
    life = lifecycle(sure_length=0.02, seconds_to_be_sure=2.0)
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.03, time=1.0)})
    assert track.first.curve.chord == pytest.approx(0.03, abs=2e-3)
    for time, grown in ((2.0, False), (2.9, False), (3.1, True)):
        track = life.next(track, time, **NOTHING | {"measurement": measurement(0.03, time=time)})
        assert track.grown is grown
    # Only volumes that show it count, and what is found after a loss may be something else.
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.03, time=1.0)})
    assert not life.next(track, 3.1, **NOTHING).grown
    track = dataclasses.replace(track, mode=TrackingMode.LOST, candidate=track.state)
    for time in (3.2, 3.3, 3.4):
        track = life.next(track, time, **NOTHING | {"measurement": measurement(0.03, time=time)})
    assert track.mode == TrackingMode.TRACKING
    assert track.first.time == pytest.approx(3.4)
    assert not track.grown


def test_a_needle_that_grew_surely_is_one():
    life = lifecycle(sure_length=0.02, grown_length=0.01, seconds_to_be_sure=9.0, max_jump=0.05)
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.012, time=1.0)})
    for time, tip, grown in ((1.3, 0.019, False), (1.6, 0.025, True)):
        track = life.next(track, time, **NOTHING | {"measurement": measurement(tip, time=time)})
        assert track.grown is grown


def test_what_turns_as_it_grows_may_be_no_needle():
    life = lifecycle(sure_length=0.02, grown_length=0.01, seconds_to_be_sure=9.0, max_jump=0.05)
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.012, time=1.0)})
    for time, aside in ((1.3, 0.019), (1.6, 0.025)):
        ends = np.array([[0.0, 0.0, 0.0], [0.019, aside, 0.0]])
        turned = dataclasses.replace(measurement(time=time), curve=NeedleCurve(ends))
        track = life.next(track, time, **NOTHING | {"measurement": turned})
        assert track.longest > 0.025
        assert not track.grown


@pytest.mark.parametrize("seen_out", [True, False])
def test_after_a_withdrawal_a_needle_must_come_again(seen_out):
    life = lifecycle(
        needle_filter=ControlPointFilter(),
        sure_length=0.02,
        seconds_to_be_sure=0.0,
        seconds_between_searches=0.1,
    )
    track = dataclasses.replace(tracked(life), earlier=(SimpleNamespace(time=-1.0),))
    times = 0.3 * np.arange(1, 50)
    for time, tip in zip(times, 0.03 - 0.0217 * times, strict=True):
        out = tip < 0.012
        seen = {} if out and not seen_out else {"measurement": measurement(tip, time=time)}
        track = life.next(track, time, **NOTHING | seen)
        if not track:
            break
        assert track.grown
    assert (track.mode, track.reason) == (TrackingMode.SEARCHING, "the needle was withdrawn")
    assert track.earlier == ()
    assert life.predict(track, time + 1, STILL).must_come


def test_a_needle_that_tissue_carries_along_is_not_lost_at_once():
    life = lifecycle(needle_filter=ControlPointFilter(), volumes_to_lose=4)
    for carried, mode in ((True, TrackingMode.COASTING), (False, TrackingMode.LOST)):
        track = tracked(life)
        for time in 0.3 * np.arange(1, 5):
            out = -0.01 * time
            seen = measurement(0.03 + out, time, entry=out if carried else 0.0)
            track = life.next(track, time, **NOTHING | {"measurement": seen})
        assert track.mode == TrackingMode.TRACKING
        assert life.next(track, 1.5, **NOTHING).mode == mode


def test_earlier_volumes_are_the_first_and_the_last_ones():
    track = Track(TrackingMode.SEARCHING, 0.0)
    volumes = [SimpleNamespace(time=0.5 * k) for k in range(100)]
    for each in volumes:
        track = track.after(each)
    times = [each.time for each in track.earlier]
    assert times == [0.0, 0.5, 1.0, *np.arange(37.0, 50.0)]
    grown = dataclasses.replace(track, grown=True)
    assert grown.after(SimpleNamespace(time=99.0)).earlier == track.earlier


def test_a_guess_that_is_not_confirmed_is_forgotten():
    life = lifecycle(volumes_to_confirm=2)
    guess = life.initiate(life.initiate(life.without_needle(0.0), detection(2e-3)), detection(6e-3))
    waiting = life.next(guess, 1.0, **NOTHING)
    assert waiting
    assert waiting.reason == "nothing seen"
    forgotten = life.next(waiting, 2.0, **NOTHING)
    assert not forgotten
    assert forgotten.detections is None
    assert forgotten.reason == "nothing moved"


def test_without_filtering_every_measurement_starts_anew():
    life = lifecycle(filtering=False)
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(0.09, y=0.1)})
    assert track.mode == TrackingMode.TRACKING
    assert track.state.told == ("start",)


def test_gate_passes_true_measurements_with_its_probability():
    rng = np.random.default_rng(0)
    for order in (2, 3):
        distances = np.linalg.norm(rng.normal(size=(20000, 3 * order)), axis=1)
        assert np.mean(distances <= gate_distance(0.9, order)) == pytest.approx(0.9, abs=0.01)


def test_a_track_is_falsy_without_a_state():
    assert not Track(TrackingMode.LOST, 0.0)
    assert not Track(TrackingMode.LOST, 0.0).estimate


@pytest.mark.parametrize(
    ("field", "value"), [("gate", 1.0), ("volumes_to_lose", 0), ("first_std", -1.0)]
)
def test_parameters_are_checked(field, value):
    with pytest.raises(ValueError, match=field):
        TrackParameters(**{field: value})
