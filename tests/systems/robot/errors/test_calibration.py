import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.diagrams.assembly import assemble_arm
from sonoservo.systems.robot.errors.calibration import (
    CalibrationParameters,
    hand_eye_error,
    joint_offsets,
)
from sonoservo.systems.robot.forward_kinematics import ForwardKinematics


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


def test_without_errors_nothing_is_wrong():
    exact = CalibrationParameters()
    assert hand_eye_error(exact, 5).IsExactlyIdentity()
    assert not joint_offsets(exact, 6, 5).any()
    assert not exact.moves_probe
    assert CalibrationParameters(joint_offset_deg=0.1).moves_probe
    assert assemble_arm(X_PC=RigidTransform()).frame.name() == "probe"


def test_joint_offsets_have_their_deviation():
    offsets = joint_offsets(CalibrationParameters(joint_offset_deg=0.2), 4000, 3)
    assert np.rad2deg(offsets.std()) == pytest.approx(0.2, rel=0.05)


def test_forward_kinematics_is_the_plants():
    X_PC = RigidTransform([1e-3, 2e-3, 3e-3])
    arm = assemble_arm(X_PC=X_PC)
    leaf = ForwardKinematics(plant=arm.plant, frame=arm.frame)
    context = leaf.CreateDefaultContext()
    q = arm.home + np.linspace(-0.3, 0.3, 6)
    leaf.get_input_port().FixValue(context, np.concatenate([q, np.ones(6)]))
    plant_context = arm.plant.CreateDefaultContext()
    arm.plant.SetPositions(plant_context, q)
    expected = arm.probe.EvalPoseInWorld(plant_context) @ X_PC
    assert leaf.get_output_port().Eval(context).IsNearlyEqualTo(expected, 1e-12)
