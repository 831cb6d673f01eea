"""Delay and hand-eye error from tissue that stands still: errors put in are the truth."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation
from still_tissue import LyingProbe, wandering

from sonoservo.systems.calibration import estimate_pose_errors
from sonoservo.systems.calibration.pose_errors import (
    PoseCalibration,
    PoseErrors,
    TissueDisplacement,
    displacement_between,
    pose_equations,
)
from sonoservo.systems.signals import NotFound
from sonoservo.systems.signals.volume import acquired_from


def displaced(translation_mm, rotation_deg):
    turn = Rotation.from_rotvec(np.deg2rad(rotation_deg)).as_matrix()
    return RigidTransform(RotationMatrix(turn), 1e-3 * np.array(translation_mm))


ERRORS = displaced([1.0, -0.5, 1.5], [0.6, -0.6, 0.5])
LYING = LyingProbe(delay=0.06, X_PI=ERRORS)


def calibrated(volumes):
    return reduce(PoseCalibration.seen, volumes, PoseCalibration())


@pytest.fixture(scope="module")
def calibration():
    return calibrated(map(LYING.volume, range(16)))


def found(errors):
    return np.array([errors.delay, *errors.translation, *errors.rotation])


def truth(probe=LYING):
    rotation = Rotation.from_matrix(probe.X_PI.rotation().matrix()).as_rotvec()
    return np.concatenate([[probe.delay], probe.X_PI.translation(), rotation])


def test_a_pose_that_is_wrong_by_2_mm_moves_all_tissue_by_as_much():
    honest = LyingProbe()
    shift = np.array([1.5e-3, -0.8e-3, 1.0e-3])
    moved = replace(honest, path=lambda t: RigidTransform(-shift).multiply(wandering(t)))
    seen = displacement_between(
        honest.volume(0), replace(moved.volume(0), motion=honest.volume(0).motion)
    )
    np.testing.assert_allclose(np.median(seen.displacement, axis=0), shift, atol=0.1e-3)


@settings(max_examples=8, deadline=None)
@given(
    delay=st.floats(-0.02, 0.02),
    translation=st.tuples(*3 * [st.floats(-0.5, 0.5)]),
    rotation=st.tuples(*3 * [st.floats(-0.3, 0.3)]),
)
def test_equations_hold_to_first_order(volumes, delay, translation, rotation):
    """Where each volume shows a point follows from the poses that it was made with, exactly."""
    probe = LyingProbe(delay=delay, X_PI=displaced(translation, rotation))
    rng = np.random.default_rng(0)
    p_W = rng.uniform([-15e-3, 20e-3, -10e-3], [15e-3, 60e-3, 10e-3], (8, 3))
    claimed, said = [], []
    for volume in volumes:
        times = volume.motion.times
        true = replace(volume, motion=replace(volume.motion, X_WP=poses(wandering, times)))
        false = replace(
            volume,
            X_WP=probe.measured(volume.time),
            motion=replace(volume.motion, X_WP=poses(probe.measured, times)),
        )
        said.append(false)
        claimed.append(false.to_world(acquired_from(true, p_W))[0])
    seen = TissueDisplacement(claimed[0], claimed[1] - claimed[0])
    equations = pose_equations(*said, seen, (0, 1))
    predicted = equations.matrix @ truth(probe)
    size = np.abs(equations.displacement).max()
    np.testing.assert_allclose(predicted, equations.displacement, atol=0.05 * size + 5e-6)


@pytest.fixture(scope="module")
def volumes():
    honest = LyingProbe()
    return [honest.volume(0), honest.volume(3)]


def poses(path, times):
    return np.array([path(t).GetAsMatrix4() for t in times])


def test_errors_are_found_and_their_doubt_is_right(calibration):
    errors = calibration.errors
    assert isinstance(errors, PoseErrors)
    off = found(errors) - truth()
    assert abs(off[0]) < 3e-3
    assert np.linalg.norm(off[1:4]) < 0.8e-3
    assert np.linalg.norm(np.rad2deg(off[4:])) < 0.4
    # It must say less than an unaided guess would, and not more than it knows.
    assert (errors.std < [5e-3, *3 * [1e-3], *3 * [np.deg2rad(1.0)]]).all()
    assert np.abs(off / errors.std).max() < 4
    assert off @ np.linalg.solve(errors.covariance, off) < 30  # 99.99 % of chi-squared with 7


def test_corrected_poses_are_true(calibration):
    volume = LYING.volume(31)
    corrected = calibration.errors.corrected(volume)

    def off(pose, time):
        return 1e3 * np.linalg.norm((wandering(time).inverse() @ pose).translation())

    before = off(volume.X_WP, volume.time)
    assert before > 1.5
    assert off(corrected.X_WP, volume.time) < 0.4 * before
    for k in (0, 24):
        pose = RigidTransform(corrected.motion.X_WP[k])
        assert off(pose, volume.motion.times[k]) < 0.5 * before
    np.testing.assert_array_equal(corrected.intensities, volume.intensities)
    still = replace(volume, motion=None)
    exact = volume.X_WP.multiply(calibration.errors.X_PI)
    assert calibration.errors.corrected(still).X_WP.IsNearlyEqualTo(exact, 1e-12)


def test_a_probe_at_rest_tells_nothing_and_few_pairs_are_too_few(calibration):
    resting = LyingProbe(delay=0.1, path=lambda _: RigidTransform())
    known = calibrated(map(resting.volume, range(3)))
    assert not known.equations
    assert estimate_pose_errors(calibration.equations[:7]).reason.startswith("7 pairs of volumes")
    assert isinstance(estimate_pose_errors(calibration.equations[:8]), PoseErrors)
    assert isinstance(known.errors, NotFound)


def test_tissue_that_breathes_is_noticed():
    """It goes up and down below a probe that is thought to sway as before."""

    def seen_from(time):
        return RigidTransform([0.0, 2.5e-3 * np.sin(2 * np.pi * 0.25 * time), 0.0]) @ wandering(
            time
        )

    breathing = LyingProbe(path=seen_from)
    volumes = []
    for each in map(breathing.volume, range(9)):
        said = replace(each.motion, X_WP=poses(wandering, each.motion.times))
        volumes.append(replace(each, X_WP=wandering(each.time), motion=said))
    assert calibrated(volumes).errors.reason.startswith(
        "the tissue moves: half of it is off by more than "
    )


def test_a_probe_that_lands_and_rests_tells_no_error_that_is_not_there():
    """The tissue gives way by 0.2 mm, and tilted, as the probe comes to rest on it."""

    def landing(time):
        return RigidTransform([0, -2e-3 * max(0.0, 1.2 - time), 0])

    probe, pressed = LyingProbe(path=landing), RotationMatrix.MakeXRotation(5e-3)
    volumes = [
        replace(each, X_WP=each.X_WP.multiply(RigidTransform(pressed, [0, 0.2e-3, 0])))
        if number >= 4
        else each
        for number, each in enumerate(map(probe.volume, range(14)))
    ]
    errors = calibrated(volumes).errors
    assert not errors.told.all()
    assert (np.abs(found(errors)) < 2 * errors.std)[errors.told].all()


def test_without_errors_none_are_found():
    errors = calibrated(map(LyingProbe().volume, range(16))).errors
    assert errors.told.all()
    assert (np.abs(found(errors)) < 2 * errors.std).all()


@pytest.mark.slow
def test_what_the_motion_does_not_show_stays_near_zero():
    """A probe that only slides shows no translation of the image."""
    sliding = LyingProbe(
        X_PI=displaced([2.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
        path=lambda t: RigidTransform([2.5e-3 * np.sin(1.7 * t), 0.0, 2e-3 * np.sin(2.1 * t)]),
    )
    errors = calibrated(map(sliding.volume, range(9))).errors
    assert np.linalg.norm(errors.translation) < 0.1e-3
    np.testing.assert_allclose(errors.std[1:4], 3e-3, rtol=0.05)
