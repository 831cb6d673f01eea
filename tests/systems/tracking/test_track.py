"""Life of a track."""

import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.signals import (
    LineHypotheses,
    NeedleCurve,
    NeedleMeasurement,
    NotFound,
    SearchReason,
    TrackingMode,
    VelocityMeasurement,
)
from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES
from sonoservo.systems.tracking import TrackParameters
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter
from sonoservo.systems.tracking.control_point_filter import ControlPointFilter
from sonoservo.systems.tracking.track import Track
from sonoservo.systems.tracking.track_lifecycle import TrackLifecycle

STILL = RigidTransform()
NO_LINES = NotFound("no lines")
NOTHING = {
    "detection": NotFound("nothing moved"),
    "measurement": NotFound("nothing seen"),
    "velocity": NotFound("not measured"),
    "lines": NO_LINES,
}


def lifecycle(anywhere=False, needle_filter=None, **parameters):
    return TrackLifecycle(
        order=2,
        parameters=TrackParameters(**parameters),
        needle_filter=needle_filter or ControlPointFilter(),
        anywhere=anywhere,
    )


def measurement(tip=0.03, time=0.0, y=0.0, entry=0.0):
    curve = NeedleCurve([[entry, y, 0], [tip, y, 0]])
    return NeedleMeasurement(curve, 1e-6 * np.eye(6), time, 100, 0.8)


def lines(*, needle=0.99, looks=0.0, looked=0, kind="needle", y=0.0):
    """Two lines, of which the second may be a needle."""
    classes = np.full((2, len(LINE_CLASSES)), 0.01)
    classes[1, LINE_CLASSES.index(kind)] = 0.96
    ends = np.array([[[0, 0.05, 0], [0.03, 0.05, 0]], [[0, y, 0], [0.03, y, 0]]])
    return LineHypotheses(
        0.0, ends, [0.01, needle], classes, [-9.0, looks], [0.0, looked], np.arange(2.0)
    )


def tracked(life, time=0.0):
    return Track.confirmed(life.needle_filter.start(measurement(time=time)), time)


def test_a_line_that_is_a_needle_is_localized_and_followed():
    life = lifecycle()
    track = Track.without_needle(0.0)
    expected = life.predict(track, 1.0, STILL, lines())
    assert expected.found
    np.testing.assert_allclose(expected.curve.control_points, lines().ends[1])
    seen = NOTHING | {"lines": lines(needle=0.97)}
    assert not life.next(track, 1.0, **seen)
    followed = life.next(track, 1.0, **seen | {"measurement": measurement()})
    assert followed.mode == TrackingMode.TRACKING
    assert followed.estimate.probability == pytest.approx(0.97)
    # Each volume that shows it is evidence for a needle, and each that does not against one.
    again = life.next(followed, 1.3, **NOTHING | {"measurement": measurement()})
    assert again.probability > followed.probability
    assert life.next(again, 1.6, **NOTHING).probability < again.probability


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("needle", "no line is a needle with certainty yet"),
        ("resting", "the line most like a needle was there before"),
        ("riding", "the line most like a needle moves along with the probe"),
        ("appeared", "the line most like a needle appeared at once"),
        ("nothing", "no line stands out as a needle does"),
    ],
)
def test_a_line_that_is_none_says_what_it_is_like(kind, words):
    life = lifecycle()
    nothing = Track.without_needle(0.0)
    reason = life.predict(nothing, 1.0, STILL, lines(needle=0.9, kind=kind)).reason
    assert (reason, SearchReason.of(str(reason)).words) == (words, words)
    assert life.predict(nothing, 1.0, STILL, NO_LINES) is NO_LINES
    seen = lines(needle=0.9, kind=kind)
    unsure = dataclasses.replace(seen, classes=0.9 * seen.classes)
    assert "yet" in life.predict(nothing, 1.0, STILL, unsure).reason


@pytest.mark.parametrize(
    ("anywhere", "lost", "looks", "looked", "found"),
    [
        (True, False, 4.0, 3, True),
        (True, False, 4.0, 2, False),
        (True, False, 0.5, 3, True),
        (True, False, -0.5, 3, False),
        (False, False, 4.0, 3, False),
        (False, True, 4.0, 3, True),
    ],
)
def test_a_line_at_rest_is_a_needle_by_its_looks_where_that_is_allowed(
    anywhere, lost, looks, looked, found
):
    life = lifecycle(anywhere=anywhere)
    track = Track.without_needle(0.0)
    if lost:
        track = dataclasses.replace(tracked(life), mode=TrackingMode.LOST)
    resting = lines(needle=0.0, looks=looks, looked=looked, kind="resting")
    assert bool(life.predict(track, 1.0, STILL, resting)) is found


def test_a_lost_needle_is_rather_found_where_it_was():
    life = lifecycle()
    lost = dataclasses.replace(tracked(life), mode=TrackingMode.LOST)
    for y, found in ((0.0, True), (0.06, False)):
        resting = lines(needle=0.0, looks=2.0, looked=3, kind="resting", y=y)
        assert bool(life.predict(lost, 1.0, STILL, resting)) is found


def test_a_line_found_aside_stays_the_needle_by_its_looks_alone():
    life = lifecycle()
    lost = dataclasses.replace(tracked(life), mode=TrackingMode.LOST)

    def seen(track, time, looks, y=0.03):
        resting = lines(needle=0.0, looks=looks, looked=3, kind="resting", y=y)
        return life.next(
            track, time, **NOTHING | {"measurement": measurement(time=time, y=y), "lines": resting}
        )

    again = seen(lost, 1.0, 2.5)
    found = again.probability
    assert again.mode == TrackingMode.TRACKING
    assert 0.6 < found < life.parameters.act
    for time in (1.3, 1.6, 1.9, 2.2):  # seeing the same once more is no evidence
        again = seen(again, time, 2.5)
    assert (again.mode, again.probability) == (TrackingMode.TRACKING, pytest.approx(found))
    refuted = seen(again, 2.5, -2.0)
    assert (refuted.mode, refuted.since) == (TrackingMode.LOST, lost.since)
    gone = again
    for time in (2.5, 2.8, 3.1, 3.4):  # not seen any more, it is sought where it was lost
        gone = life.next(gone, time, **NOTHING)
    assert (gone.mode, gone.since, gone.search) == (TrackingMode.LOST, lost.since, None)
    np.testing.assert_allclose(gone.state.curve.tip, lost.state.curve.tip)
    sure = seen(again, 2.5, 6.0)
    assert life.next(sure, 2.8, **NOTHING | {"measurement": measurement(time=2.8, y=0.03)})
    # Where the needle was lost, the same looks leave no doubt.
    assert seen(lost, 1.0, 3.0, y=0.0).probability > life.parameters.act


def test_the_prediction_says_what_is_known():
    life = lifecycle()
    track = dataclasses.replace(tracked(life), missed=2, entry=np.zeros(3))
    expected = life.predict(track, 1.0, STILL, NO_LINES)
    assert (expected.time, expected.missed, expected.found) == (1.0, 2, False)
    np.testing.assert_array_equal(expected.entry, track.entry)
    assert expected.covariance.shape == (6, 6)


def test_a_track_in_the_probe_s_frame_is_carried_along():
    X = RigidTransform([0.0, 0.01, 0.0])
    track = tracked(lifecycle())
    assert track.seen_from(X) is track
    track = dataclasses.replace(track, X_WP=STILL, entry=np.zeros(3))
    carried = track.seen_from(X)
    np.testing.assert_allclose(carried.state.curve.tip, [0.03, 0.01, 0.0])
    assert carried.X_WP is X
    predicted = lifecycle().predict(track, 1.0, X, NO_LINES)
    np.testing.assert_allclose(predicted.entry, [0.0, 0.01, 0.0])


def test_two_rejected_measurements_that_agree_start_anew():
    life = lifecycle()
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": measurement(y=0.02)})
    assert track.mode == TrackingMode.COASTING
    assert track.rejected is not None
    assert track.innovation > life.gate
    elsewhere = life.next(track, 1.3, **NOTHING | {"measurement": measurement(y=-0.02)})
    assert elsewhere.mode == TrackingMode.COASTING
    found = measurement(y=0.021)
    again = life.next(track, 1.3, **NOTHING | {"measurement": found})
    assert again.mode == TrackingMode.TRACKING
    np.testing.assert_array_equal(again.state.mean, life.needle_filter.start(found).mean)
    assert again.rejected is None


def test_coast_lose_find_again_and_give_up():
    life = lifecycle(volumes_to_lose=2, seconds_to_give_up=3.0)
    track = tracked(life)
    modes = []
    for time in (1.0, 2.0, 3.0, 4.0):
        track = life.next(track, time, **NOTHING)
        modes.append(track.mode)
    assert modes == ["coasting", "lost", "lost", "searching"]


def test_a_needle_that_comes_out_ends_its_track():
    life = lifecycle()
    track = tracked(life)
    for time in 0.3 * np.arange(1, 50):
        tip = 0.03 - 0.0217 * time
        seen = {"measurement": measurement(tip, time=time)} if tip > 0.012 else {}
        track = life.next(track, time, **NOTHING | seen)
        if not track:
            break
    assert (track.mode, track.reason) == (TrackingMode.SEARCHING, "the needle was withdrawn")


def test_a_needle_that_tissue_carries_along_is_not_lost_at_once():
    life = lifecycle(volumes_to_lose=4)
    for carried, mode in ((True, TrackingMode.COASTING), (False, TrackingMode.LOST)):
        track = tracked(life)
        for time in 0.3 * np.arange(1, 5):
            out = -0.01 * time
            seen = measurement(0.03 + out, time, entry=out if carried else 0.0)
            track = life.next(track, time, **NOTHING | {"measurement": seen})
        assert track.mode == TrackingMode.TRACKING
        assert life.next(track, 1.5, **NOTHING).mode == mode


def test_without_filtering_every_measurement_starts_anew():
    life = lifecycle(filtering=False)
    found = measurement(0.09, y=0.1)
    track = life.next(tracked(life), 1.0, **NOTHING | {"measurement": found})
    assert track.mode == TrackingMode.TRACKING
    np.testing.assert_array_equal(track.state.mean, life.needle_filter.start(found).mean)


@pytest.mark.parametrize("seen", [measurement(time=0.3), NotFound("nothing seen")])
def test_a_measured_velocity_counts_with_and_without_a_needle_in_sight(seen):
    life = lifecycle(needle_filter=AxisTipFilter())
    speed = VelocityMeasurement([0.01, 0, 0], 1e-8 * np.eye(3), 0.9)
    told, untold = (
        life.next(tracked(life), 0.3, **NOTHING | {"measurement": seen, "velocity": velocity})
        for velocity in (speed, NotFound("not measured"))
    )
    assert told.state.tip_velocity[0] > untold.state.tip_velocity[0] + 5e-3
    assert (told.mode, told.innovation is None) == (
        (TrackingMode.TRACKING, False) if seen else (TrackingMode.COASTING, True)
    )
