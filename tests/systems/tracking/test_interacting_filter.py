"""A filter that knows which measurements repeat each other, and that hands mostly move evenly."""

import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.signals import NeedleCurve, NeedleMeasurement
from sonoservo.systems.tracking.interacting_filter import InteractingFilter
from sonoservo.systems.tracking.track_lifecycle import gate_distance, innovation_distance

FILTER = InteractingFilter()
R = np.diag([1.0, 0.1, 0.1, 0.5, 0.1, 0.1]) ** 2 * 1e-6
PERIOD = 0.3


def measurement(number, tip=0.03, X_WP=None, covariance=R):
    curve = NeedleCurve([[0.0, 0, 0], [tip, 0, 0]])
    return NeedleMeasurement(curve, covariance, PERIOD * number, 100, 0.8, X_WP)


def follow(measurements, needle_filter=FILTER):
    measurements = iter(measurements)
    state = needle_filter.start(next(measurements))
    for z in measurements:
        state = needle_filter.update(needle_filter.predict(state, z.time), z, None)
    return state


def tip_std(state):
    return float(np.sqrt(state.covariance[3, 3]))


def at_rest(number):
    return measurement(number, X_WP=RigidTransform())


def test_repetitions_at_rest_are_no_evidence_and_looks_from_elsewhere_are():
    stds = [tip_std(follow(at_rest(k) for k in range(count))) for count in (1, 3, 40)]
    assert stds[0] == pytest.approx(0.5e-3)
    assert min(stds) > 0.85 * stds[0]
    known = tip_std(
        follow(
            measurement(k, X_WP=RigidTransform(RollPitchYaw(0, 0.1 * k, 0), [2e-3 * k, 0, 0]))
            for k in range(40)
        )
    )
    # What never changes is left over.
    assert np.sqrt(FILTER.constant) * 0.5e-3 < known < 0.8 * stds[2]


def test_a_direction_that_jitters_does_not_move_the_entry():
    """To and fro, a sweep shows a needle that rests 0.2 mm to either side."""

    def jittering(number):
        aside = 0.2e-3 * (-1) ** number
        ends = np.array([[0, aside, 0], [0.03, 0.2 * aside, 0]])
        k = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        along, across = np.diag([1.0, 0.36]) * 1e-6, 0.0225e-6 * np.eye(6)
        covariance = np.kron(along, np.outer(k, k)) + across
        curve = NeedleCurve(ends)
        return NeedleMeasurement(curve, covariance, PERIOD * number, 100, 0.8, RigidTransform())

    entry = follow(jittering(k) for k in range(60)).curve.entry
    np.testing.assert_allclose(entry, 0, atol=0.7e-3)


def test_a_hand_that_stops_is_noticed():
    tips = [0.02 + 8e-3 * PERIOD * min(k, 10) for k in range(16)]
    state = follow(measurement(k, tip) for k, tip in enumerate(tips))
    assert state.curve.tip[0] == pytest.approx(tips[-1], abs=0.3e-3)
    np.testing.assert_allclose(state.velocity[1], 0, atol=0.5e-3)
    moving = follow(measurement(k, tip) for k, tip in enumerate(tips[:10]))
    assert moving.velocity[1][0] == pytest.approx(8e-3, abs=0.5e-3)


@pytest.mark.parametrize(
    ("speed", "follows", "least", "off"), [(5e-3, True, 0.9, 0.2e-3), (2e-3, False, 0.6, 0.6e-3)]
)
def test_a_needle_that_is_pushed_from_the_first_volume_on_advances(speed, follows, least, off):
    """What fades would slide along with a probe that follows it, but that it does is not likely."""
    along = speed * PERIOD * np.arange(8)
    measured = [measurement(k, 0.02 + x) for k, x in enumerate(along)]
    if follows:
        measured = [
            dataclasses.replace(z, X_WP=RigidTransform([x, 0, 0]), unseen=0.1)
            for z, x in zip(measured, along, strict=True)
        ]
    state = follow(measured)
    assert state.weights[::3].sum() > least
    assert state.velocity[1][0] == pytest.approx(speed, abs=off)
    if follows:
        assert state.curve.tip[0] == pytest.approx(0.02 + along[-1], abs=0.2e-3)


def test_a_needle_that_breathes_with_the_tissue_is_followed():
    """10 mm from peak to peak, across the needle; the velocity is judged as stated, too."""
    rng, inside, passed, period = np.random.default_rng(4), [], [], 3.0
    noise = 0.1e-3 * rng.normal(size=(60, 3))
    state = None
    for k in range(60):
        phase = 2 * np.pi * PERIOD * k / period
        true = 5e-3 * np.array([0, np.sin(phase), 0])
        velocity = 5e-3 * 2 * np.pi / period * np.array([0, np.cos(phase), 0])
        z = measurement(k, X_WP=RigidTransform())
        z = dataclasses.replace(z, curve=NeedleCurve(z.curve.control_points + true + noise[k]))
        if state is None:
            state = FILTER.start(z)
            continue
        predicted = FILTER.predict(state, z.time)
        passed.append(innovation_distance(predicted, z) <= gate_distance(0.9999, 2))
        state = FILTER.update(predicted, z, None)
        miss = state.velocity[1] - velocity
        inside.append(miss @ np.linalg.solve(state.covariance[9:12, 9:12], miss) < 7.815)
    assert np.mean(inside) >= 0.9
    assert np.mean(passed) >= 0.95


def test_of_two_places_the_tip_is_at_that_which_was_predicted():
    """The more probable one, by what a volume shows, may be the wrong one."""
    pushed = [measurement(k, 0.02 + 5e-3 * PERIOD * k) for k in range(8)]
    state = follow(pushed)
    truth = 0.02 + 5e-3 * PERIOD * 8
    short = dataclasses.replace(
        measurement(8, truth - 12e-3), tip_seen=0.8, elsewhere=np.array([[0.2, 12e-3, 1e-3]])
    )
    predicted = FILTER.predict(state, short.time)
    assert innovation_distance(predicted, short) < gate_distance(0.9999, 2)
    assert FILTER.update(predicted, short, None).curve.tip[0] == pytest.approx(truth, abs=0.3e-3)


def along(tips, unseen):
    """State after measured tips of which something may hide the rest."""
    return follow(
        dataclasses.replace(measurement(k, tip, RigidTransform()), unseen=unseen)
        for k, tip in enumerate(tips)
    )


def test_an_end_that_was_seen_to_advance_is_the_tip():
    pushed = 0.02 + 8e-3 * PERIOD * np.arange(8)
    assert tip_std(along(pushed[:1], 0.3)) > 12e-3
    assert tip_std(along(pushed, 0.3)) < 4e-3
    # One that never moved may hide the rest of the needle for ever.
    assert tip_std(along(np.full(30, 0.02), 0.3)) > 10e-3


def test_an_end_that_stops_where_needles_fade_may_hide_the_rest():
    tips = 0.02 + 8e-3 * PERIOD * np.minimum(np.arange(16), 8)
    clear, fading = (along(tips, unseen) for unseen in (0.01, 0.9))
    assert clear.curve.tip[0] == pytest.approx(tips[-1], abs=0.5e-3)
    assert 2 * tip_std(clear) < tip_std(fading)
    # A hand stops before long, so what is not seen does not grow for ever.
    later = FILTER.predict(fading, fading.time + 10 * FILTER.unseen_time)
    assert later.curve.tip[0] - fading.curve.tip[0] < 8e-3 * FILTER.unseen_time


def test_a_needle_that_rests_for_long_after_a_push_hides_no_more_than_at_first():
    tips = 0.02 + 8e-3 * PERIOD * np.minimum(np.arange(60), 10)
    state = along(tips, 0.1)
    assert state.weights[2::3].sum() < 0.2
    assert state.curve.tip[0] == pytest.approx(tips[-1], abs=1.5e-3)


def test_a_needle_that_jerks_is_followed():
    """A hand takes it back by 20 mm in two volumes; each says that its old place is not likely."""
    tips = [*[0.05] * 12, 0.04, 0.03, 0.03]
    images = [
        dataclasses.replace(
            measurement(k, tip), tip_seen=1.0, elsewhere=np.array([[1e-4, 0.05 - tip, 3e-3]])
        )
        for k, tip in enumerate(tips)
    ]
    assert follow(images).curve.tip[0] == pytest.approx(tips[-1], abs=1e-3)


@pytest.mark.parametrize(("speed", "unseen"), [(8e-3, 0.1), (2e-3, 0.5), (5e-3, 0.5)])
def test_no_tip_lies_before_the_end_that_is_seen(speed, unseen):
    tips = 0.05 - speed * PERIOD * (8 - np.abs(np.arange(16) - 8))
    state = along(tips, unseen)
    assert state.curve.tip[0] > tips[-1] - 1e-3
    # What lies behind it has no probability, so the mean of what may hide is ahead of it as well.
    assert state.means[2::3, -2].min() > 0


def test_stated_covariance_holds_what_it_says():
    """Errors drawn as the filter believes them: a constant, a repeated and a fresh part."""
    rng = np.random.default_rng(2)
    root, inside = np.sqrt(R), []
    shares = [FILTER.constant, FILTER.repeated, 1 - FILTER.constant - FILTER.repeated]
    for _ in range(25):
        constant, repeated = (np.sqrt(s) * root @ rng.normal(size=6) for s in shares[:2])
        state = None
        for k in range(12):
            tip = 0.02 + 5e-3 * PERIOD * min(k, 6)
            if k <= 6:
                repeated = np.sqrt(shares[1]) * root @ rng.normal(size=6)
            error = constant + repeated + np.sqrt(shares[2]) * root @ rng.normal(size=6)
            z = measurement(k, tip, RigidTransform([0.05 * min(k, 6), 0, 0]))
            points = z.curve.control_points + error.reshape(2, 3)
            z = dataclasses.replace(z, curve=NeedleCurve(points))
            if state is None:
                state = FILTER.start(z)
                continue
            state = FILTER.update(FILTER.predict(state, z.time), z, None)
            miss = state.curve.tip - [tip, 0, 0]
            inside.append(miss @ np.linalg.solve(state.covariance[3:6, 3:6], miss) < 7.815)
    assert np.mean(inside) >= 0.9


def test_a_constant_and_a_repeated_part_leave_a_fresh_one():
    with pytest.raises(ValueError, match="constant \\+ repeated"):
        InteractingFilter(constant=0.5, repeated=0.5)
