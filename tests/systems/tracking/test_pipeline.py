import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.signals import NeedleCurve, NeedleMeasurement, NeedlePrediction, NotFound
from sonoservo.systems.signals.volume import acquired_from
from sonoservo.systems.tracking import NeedleLocalizerParameters, TipParameters, localize
from sonoservo.systems.tracking.pipeline import explain_localization

SCENE = Scene(
    seed=5,
    spacing=1.0e-3,
    balls=[([0.005, 0.06, 0.008], 2e-3), ([-0.01, 0.035, -0.004], 1.5e-3)],
    rods=[([-0.015, 0.07, 0.0], [-0.003, 0.072, 0.008])],
)
ENTRY = entry_on_side()
K = np.array([1, 0.25, 0.1]) / np.linalg.norm([1, 0.25, 0.1])
# The synthetic needle echoes where it is, not at its front wall, and ends as an edge.
PARAMETERS = NeedleLocalizerParameters(
    echo_offset=0.0, tip=TipParameters(beam_width=2.0e-3, bevel_length=0.0)
)


def needle(length):
    return np.array([ENTRY, ENTRY + length * K])


def expected(ends, order=2, **changes):
    """A prediction, certain to 1 mm, of a needle that has been measured before."""
    curve = NeedleCurve(np.linspace(*ends, order))
    fields = {
        "velocity": np.zeros((order, 3)),
        "covariance": 1e-6 * np.eye(3 * order),
        "entry": curve.entry,
    }
    return NeedlePrediction(order, 0.0, curve, **(fields | changes))


def run(volume, guess, seed=0, **changes):
    parameters = dataclasses.replace(PARAMETERS, **changes)
    return localize(volume, guess, parameters, np.random.default_rng(seed))


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("length", [0.012, 0.04])
def test_measures_axis_and_tip(order, length):
    X_WP = RigidTransform(RollPitchYaw(2.0, 0.3, -0.5), [0.4, 0.1, 0.2])
    ends = X_WP.multiply(needle(length).T).T
    volume = SCENE.volume(1, lambda time: ends, X_WP)
    rng = np.random.default_rng(1)
    for seed in range(2):
        guess = expected(ends + rng.normal(size=(2, 3)) * 1e-3, order)
        found = run(volume, guess, seed)
        assert isinstance(found, NeedleMeasurement)
        k = X_WP.rotation().matrix() @ K
        angle = np.degrees(np.arccos(found.curve.direction @ k))
        assert angle < (4 if length < 0.02 else 0.8)
        error = found.curve.tip - ends[1]
        assert abs(error @ k) < 1.5e-3
        assert np.linalg.norm(error - error @ k * k) < 0.8e-3
        # Interior points are uniform in chord, and the covariance is one.
        chord = np.linalg.norm(np.diff(found.curve.control_points, axis=0), axis=1)
        assert np.ptp(chord) < 0.02 * chord.sum()
        assert np.linalg.eigvalsh(found.covariance).min() > 0
        assert found.inlier_ratio > 0.3


def test_tip_that_leaves_the_field_of_view_is_uncertain():
    far = np.array([ENTRY, ENTRY + np.array([0.12, 0.01, 0])])
    volume = SCENE.volume(1, lambda time: far)
    seen = run(volume, expected(np.array([ENTRY, ENTRY + np.array([0.08, 0.006, 0])])))
    k = (far[1] - far[0]) / np.linalg.norm(far[1] - far[0])
    assert k @ seen.covariance[-3:, -3:] @ k > (5e-3) ** 2


def test_entry_outside_the_field_of_view():
    ends = np.array([ENTRY - 0.03 * K, ENTRY + 0.03 * K])
    volume = SCENE.volume(1, lambda time: ends)
    found = run(volume, expected(ends))
    assert np.linalg.norm(found.curve.tip - ends[1]) < 1.5e-3
    assert np.linalg.norm(found.curve.entry - ends[0]) < 2.5e-3


def test_a_withdrawn_needle_is_not_found_where_it_is_expected():
    withdrawn = SCENE.volume(1, lambda time: needle(0.5e-3))
    assert not run(withdrawn, expected(needle(0.01)))


def test_without_a_volume_of_interest_the_needle_is_found_wherever_it_is_predicted():
    volume = SCENE.volume(1, lambda time: needle(0.03))
    aside = expected(needle(0.03) + np.array([0.0, 0.012, 0.0]))
    assert not run(volume, aside)
    found = run(volume, aside, volume_of_interest=False)
    assert np.degrees(np.arccos(found.curve.direction @ K)) < 1


def test_without_the_angle_gate_the_predicted_direction_does_not_matter():
    volume = SCENE.volume(1, lambda time: needle(0.03))
    turn = RotationMatrix.MakeZRotation(np.radians(45)).matrix()
    turned = expected(np.array([ENTRY, ENTRY + turn @ (0.03 * K)]))
    found = run(volume, turned, volume_of_interest=False, angle_gate=False)
    assert np.degrees(np.arccos(found.curve.direction @ K)) < 1
    gated = run(volume, turned, volume_of_interest=False)
    assert not gated or gated.curve.direction @ K < np.cos(np.radians(10))


def test_without_the_sweep_s_time_a_volume_counts_as_acquired_at_its_middle():
    ends = needle(0.03)
    volume = SCENE.volume(1, lambda time: ends)
    poses = volume.motion.X_WP.copy()
    poses[:, 1, 3] += np.linspace(-5e-3, 5e-3, len(poses))  # the probe rises while it sweeps
    moving = dataclasses.replace(volume, motion=dataclasses.replace(volume.motion, X_WP=poses))
    own_times, middle = (run(moving, expected(ends), sweep_time=flag) for flag in (True, False))
    for found, seen in ((own_times, moving), (middle, moving.at_once())):
        shown = seen.to_world(volume.to_probe(ends[1:]))
        assert abs(found.curve.tip[1] - shown[0][0][1]) < 0.5e-3
    assert own_times.curve.tip[1] - middle.curve.tip[1] > 0.3e-3
    assert middle.time == moving.time != own_times.time


def test_lost_needle_is_found_among_balls_and_rods():
    elsewhere = np.array([[0.0, 0.06, 0.0], [0.03, 0.05, 0.0]])
    ends = needle(0.035)
    errors = []
    for seed in range(3):
        volume = dataclasses.replace(SCENE, seed=seed).volume(1, lambda time: ends)
        found = run(volume, expected(elsewhere, everywhere=True), seed)
        assert found
        assert np.degrees(np.arccos(found.curve.direction @ K)) < 1
        errors.append(np.linalg.norm(found.curve.tip - ends[1]))
    # Speckle right behind the tip may look like more of the needle.
    assert np.median(errors) < 1.5e-3


@pytest.mark.parametrize(("content", "everywhere"), [("constant", True), ("noise", False)])
def test_volumes_without_content(content, everywhere):
    volume = SCENE.volume(1)
    noise = np.random.default_rng(0).integers(0, 255, volume.intensities.shape)
    even = np.full(noise.shape, 80, np.uint8)
    grey = even if content == "constant" else noise.astype(np.float32)
    volume = dataclasses.replace(volume, intensities=grey)
    assert isinstance(run(volume, expected(needle(0.03), everywhere=everywhere)), NotFound)


def test_a_needle_never_seen_is_localized_in_the_whole_volume():
    volume, order = SCENE.volume(1, lambda time: needle(0.05)), 3
    anywhere = NeedlePrediction(order, 0.0, everywhere=True)
    explained = explain_localization(volume, anywhere, PARAMETERS, np.random.default_rng(0))
    found = explained.measurement
    assert found.curve.order == order
    assert np.linalg.norm(found.curve.tip - needle(0.05)[1]) < 2e-3
    assert len(explained.attempts) >= 7
    assert explained.probability > 0.8
    nothing = run(dataclasses.replace(SCENE, rods=()).volume(1), anywhere)
    assert nothing.reason


def test_explanation_has_all_that_was_looked_at():
    volume = SCENE.volume(1, lambda time: needle(0.03))
    prediction = expected(needle(0.03))
    explained = explain_localization(volume, prediction, PARAMETERS, np.random.default_rng(0))
    assert explained.volume_time == volume.time
    assert explained.prediction is prediction
    (attempt,) = explained.attempts
    assert attempt.measurement is explained.measurement
    np.testing.assert_array_equal(
        explained.measurement.curve.control_points, run(volume, prediction).curve.control_points
    )
    np.testing.assert_array_equal(attempt.region.entry, prediction.entry)
    assert len(attempt.candidates) == len(attempt.weights) == len(attempt.inliers) > 100
    aside = attempt.candidates - ENTRY
    aside = np.linalg.norm(aside - np.outer(aside @ K, K), axis=1)
    assert np.median(aside[attempt.inliers]) < 1e-3 < np.median(aside[~attempt.inliers])
    # The speed of sound is unknown by 2 %: so are all depths, alike.
    depths = acquired_from(volume, attempt.measurement.curve.control_points)[:, 1]
    deeper = np.kron(np.eye(2), volume.X_WP.rotation().matrix()[:, 1])
    np.testing.assert_allclose(
        deeper @ attempt.measurement.common @ deeper.T, np.outer(depths, depths) * 0.02**2
    )
    profile, extent = attempt.profile, attempt.extent
    tip = profile.p_W[np.searchsorted(profile.a, extent.tip)]
    assert np.linalg.norm(tip - needle(0.03)[1]) < 2e-3
    inside = (profile.a > extent.start + 3e-3) & (profile.a < extent.tip - 3e-3)
    assert np.median((profile.level - profile.background)[inside]) > 6


def test_explanation_of_a_failure_ends_where_it_failed():
    explain = lambda volume, guess: explain_localization(  # noqa: E731
        volume, guess, PARAMETERS, np.random.default_rng(0)
    )
    outside, narrow = explain(SCENE.volume(1), expected(needle(0.03) + 1.0)).attempts
    assert narrow.region.radius < outside.region.radius
    assert outside.measurement.reason == "the predicted needle lies outside the field of view"
    assert outside.candidates is outside.inliers is outside.profile is outside.extent is None
    empty, _ = explain(SCENE.volume(1), expected(needle(0.03))).attempts
    assert not empty.measurement
    assert len(empty.candidates) > 100


def faded(length, beyond):
    """A needle that fades out over its last centimetre, and the volume that shows it."""
    shown, none = (SCENE.volume(1, ends) for ends in (lambda time: needle(length), None))
    p_P = none.position(np.moveaxis(np.indices(none.intensities.shape), 0, -1))
    share = np.clip((length - beyond - (p_P - ENTRY) @ K) / 0.01, 0, 1)
    grey = share * shown.intensities + (1 - share) * none.intensities
    return dataclasses.replace(shown, intensities=grey.astype(np.uint8))


def test_a_needle_that_fades_may_go_on_to_where_it_was():
    found = run(faded(0.05, beyond=0.015), expected(needle(0.05)))
    beyond = (needle(0.05)[1] - found.curve.tip) @ K
    assert beyond > 10e-3
    assert any(abs(beyond - away) < 2 * std for _, away, std in found.elsewhere)


def test_too_little_of_a_needle_does_not_show_that_it_turned():
    """A bright needle may turn by 8 deg; a short remainder of it may not."""
    k = RotationMatrix(RollPitchYaw(0, 0, np.radians(8))) @ K
    guess = expected(np.array([ENTRY, ENTRY + 0.05 * k]))
    assert run(SCENE.volume(1, lambda time: needle(0.05)), guess)
    short = run(SCENE.volume(1, lambda time: needle(0.012)), guess)
    assert isinstance(short, NotFound)


def test_a_needle_on_its_way_out_is_followed_past_the_entry_once_known():
    """The probe has followed it, so that more of it is in view than at first."""
    ends = needle(0.04)
    volume = SCENE.volume(1, lambda time: ends)
    known = expected(np.array([ends[1] - 2e-3 * K, ends[1] + 1e-3 * K]))
    found = run(volume, known)
    assert (known.entry - found.curve.entry) @ K > 2e-3
    assert np.linalg.norm(found.curve.tip - ends[1]) < 1.5e-3
