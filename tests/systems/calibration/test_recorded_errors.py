"""Errors of recorded poses, and how much few places of the probe tell of them."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from scipy.spatial.transform import Rotation
from still_tissue import LyingProbe

from sonoservo.systems.calibration.pose_errors import PoseErrors
from sonoservo.systems.calibration.recorded_errors import RecordedCalibration, are_told
from sonoservo.systems.signals import NotFound


def found(errors):
    return np.array([errors.delay, *errors.translation, *errors.rotation])


def calibrated(volumes):
    known = RecordedCalibration()
    for each in volumes:
        known = known.seen(each)
    return known.errors


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
    errors = calibrated(volumes)
    if isinstance(errors, NotFound):
        assert "cannot be told from these volumes" in errors.reason
    else:
        told = are_told(errors)
        assert not told.all()
        assert (np.abs(found(errors)) < 2 * errors.std)[told].all()


@pytest.mark.parametrize("turned_deg", [0.0, 3.0])
def test_an_error_of_3_deg_and_2_mm_is_found_and_none_is_not(turned_deg):
    turn = np.deg2rad(turned_deg) * np.array([0.6, -0.6, 0.53])
    moved = 2e-3 * turned_deg / 3 * np.array([0.6, 0.5, -0.62])
    R = RotationMatrix(Rotation.from_rotvec(turn).as_matrix())
    errors = calibrated(map(LyingProbe(X_PI=RigidTransform(R, moved)).volume, range(20)))
    assert isinstance(errors, PoseErrors)
    assert are_told(errors).all()
    off = found(errors) - [0.0, *moved, *turn]
    assert (np.abs(off) < 2 * errors.std).all()
    assert np.rad2deg(np.linalg.norm(errors.std[4:])) < 2
