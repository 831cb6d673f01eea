import numpy as np
import pytest

from sonoservo.systems.robot import CalibrationParameters
from sonoservo.systems.robot.errors.calibration import hand_eye_error, joint_offsets


def test_hand_eye_error_has_its_length_and_angle_and_any_direction():
    parameters = CalibrationParameters(hand_eye_translation=2e-3, hand_eye_rotation_deg=1.0)
    errors = [hand_eye_error(parameters, seed) for seed in range(200)]
    turns = [X.rotation().ToAngleAxis() for X in errors]
    shifts = np.array([X.translation() for X in errors])
    np.testing.assert_allclose(np.linalg.norm(shifts, axis=1), 2e-3)
    np.testing.assert_allclose(np.rad2deg([turn.angle() for turn in turns]), 1.0)
    for directions in (shifts / 2e-3, np.array([turn.axis() for turn in turns])):
        # Isotropic: each component has mean 0 and mean square 1/3.
        assert np.abs(directions.mean(axis=0)).max() < 4 * np.sqrt(1 / 3 / 200)
        np.testing.assert_allclose((directions**2).mean(axis=0), 1 / 3, atol=0.09)


def test_joint_offsets_have_their_deviation():
    offsets = joint_offsets(CalibrationParameters(joint_offset_deg=0.2), 4000, 3)
    assert np.rad2deg(offsets.std()) == pytest.approx(0.2, rel=0.05)
