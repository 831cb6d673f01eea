"""The corrector as a block: what it outputs, and when."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from scipy.spatial.transform import Rotation
from still_tissue import LyingProbe

from sonoservo.systems.calibration import HandEyeCorrector, PoseCorrector
from sonoservo.systems.calibration.pose_errors import PoseErrors
from sonoservo.systems.signals import NotFound

LYING = LyingProbe(delay=0.06, X_PI=RigidTransform([1e-3, 0.0, 1e-3]))


@pytest.fixture(scope="module")
def volumes():
    return [LYING.volume(number) for number in range(14)]


def give(system, context, volume):
    system.GetInputPort("volume").FixValue(context, Value[object](volume))
    return system.GetOutputPort("volume").Eval(context)


def test_poses_are_corrected_once_errors_are_known(volumes):
    system = PoseCorrector(period=1.0)
    context = system.CreateDefaultContext()
    errors = system.GetOutputPort("pose_errors")
    for volume in volumes:
        known = errors.Eval(context)
        before = give(system, context, volume)
        system.ExecuteForcedEvents(context)
        after = system.GetOutputPort("volume").Eval(context)
        assert after is before  # or a tracker would take it for another volume
        if isinstance(known, PoseErrors):
            np.testing.assert_array_equal(
                before.X_WP.GetAsMatrix4(), known.corrected(volume).X_WP.GetAsMatrix4()
            )
        else:
            assert before is volume
    assert isinstance(errors.Eval(context), PoseErrors)
    assert errors.Eval(context).delay == pytest.approx(0.06, abs=6e-3)


def test_the_hand_eye_error_is_taken_out_of_a_pose():
    X_PI = RigidTransform(RollPitchYaw(0.01, -0.02, 0.03), [1e-3, 2e-3, -3e-3])
    X_WP = RigidTransform(RollPitchYaw(0.1, 0.2, -0.3), [0.1, 0.2, 0.3])
    turn = Rotation.from_matrix(X_PI.rotation().matrix()).as_rotvec()
    errors = PoseErrors(0.05, X_PI.translation(), turn, np.eye(7), places=9, pairs=9, blocks=90)
    system = HandEyeCorrector()
    context = system.CreateDefaultContext()
    system.GetInputPort("X_WP").FixValue(context, Value(X_WP))
    for value, expected in ((errors, X_WP @ X_PI), (NotFound("too few"), X_WP)):
        system.GetInputPort("pose_errors").FixValue(context, Value[object](value))
        pose = system.GetOutputPort("corrected_X_WP").Eval(context)
        np.testing.assert_allclose(pose.GetAsMatrix4(), expected.GetAsMatrix4(), atol=1e-12)
