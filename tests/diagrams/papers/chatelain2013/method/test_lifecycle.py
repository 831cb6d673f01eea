"""The published life of a track: no gate, no search for a lost needle."""

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.diagrams.papers.chatelain2013.method.lifecycle import PublishedLifecycle
from sonoservo.systems.signals import (
    InsertionDetection,
    NeedleCurve,
    NeedleMeasurement,
    NotFound,
    TrackingMode,
)
from sonoservo.systems.tracking.control_point_filter import ControlPointFilter
from sonoservo.systems.tracking.track import Track

LIFE = PublishedLifecycle(order=2, needle_filter=ControlPointFilter())
NOTHING = NotFound("nothing")


def detection(x, time=0.0):
    entry, median = np.array([x, 0, 0]), np.array([x + 2e-3, 0, 0])
    return InsertionDetection(entry, median, median, 1e-3, 6.0, time)


def measurement(tip, time=0.0):
    curve = NeedleCurve([[0, 0, 0], [tip, 0, 0]])
    return NeedleMeasurement(curve, 1e-6 * np.eye(6), time, 100, 0.8)


def step(track, time, detection=NOTHING, measurement=NOTHING):
    return LIFE.next(track, time, detection=detection, measurement=measurement, velocity=NOTHING)


def tracked():
    track = step(Track.without_needle(0.0), 0.0, detection(0.0))
    return step(track, 0.3, measurement=measurement(0.03, 0.3))


def test_one_entry_starts_the_search_and_a_later_one_replaces_it():
    waiting = Track.without_needle(0.0)
    assert not LIFE.predict(waiting, 0.0, RigidTransform())
    track = step(waiting, 0.0, detection(0.0))
    assert track.mode == TrackingMode.SEARCHING
    prediction = LIFE.predict(track, 0.3, RigidTransform())
    assert prediction.entry is None
    np.testing.assert_allclose(prediction.curve.control_points[0], 0)
    later = step(track, 0.3, detection(0.01))
    np.testing.assert_allclose(later.state.curve.entry, [0.01, 0, 0])
    assert step(later, 0.6).state is later.state


def test_no_measurement_is_too_far_off():
    track = step(tracked(), 0.6, measurement=measurement(0.09, 0.6))
    assert track.mode == TrackingMode.TRACKING
    assert track.state.curve.tip[0] > 0.05
    assert LIFE.predict(track, 0.9, RigidTransform()).entry is not None


def test_a_needle_not_seen_coasts_and_is_given_up_without_a_search():
    track = tracked()
    for n in range(1, LIFE.volumes_to_end):
        track = step(track, 0.3 + 0.3 * n)
        assert track.mode == TrackingMode.COASTING
        assert not LIFE.predict(track, 0.6 + 0.3 * n, RigidTransform()).everywhere
    assert step(track, 9.0).mode == TrackingMode.SEARCHING
