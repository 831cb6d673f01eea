import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.math import RigidTransform

from sonoservo.diagrams import assemble_arm
from sonoservo.systems.robot.posture import probe_pose, reachable, solve_posture

X_WT = RigidTransform([0.5, 0, 0.2])
VIPER, IIWA = (assemble_arm(name) for name in ("viper_s850", "lbr_iiwa_14"))


@settings(max_examples=10)
@given(
    arm=st.sampled_from([VIPER, IIWA]),
    x=st.floats(-0.06, 0.06),
    y=st.floats(-0.03, 0.03),
    yaw=st.floats(-np.pi / 3, np.pi / 3),
    height=st.floats(-0.01, 0.03),
)
def test_posture_puts_the_probe_at_the_pose(arm, x, y, yaw, height):
    wanted = probe_pose(X_WT=X_WT, x=x, y=y, yaw=yaw, height=height)
    q = solve_posture(arm, wanted)
    plant = arm.plant
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q)
    got = arm.probe.EvalPoseInWorld(context)
    np.testing.assert_allclose(got.GetAsMatrix4(), wanted.GetAsMatrix4(), atol=5e-5)
    assert (q > plant.GetPositionLowerLimits() + 0.1).all()
    assert (q < plant.GetPositionUpperLimits() - 0.1).all()
    # Elbow up, and not another of the eight solutions.
    assert np.abs(q - arm.home).max() < 1.6


def test_a_redundant_arm_finds_every_pose_that_it_reaches():
    # The solver gives up on some fifteenth of these if it starts at home and wants the nearest.
    poses = [
        probe_pose(X_WT=X_WT, x=x, y=0, yaw=yaw, height=0)
        for x in np.linspace(-0.06, 0.06, 5)
        for yaw in np.linspace(-np.pi / 3, np.pi / 3, 7)
    ]
    assert all(reachable(IIWA, poses))


def test_a_redundant_arm_stays_near_the_posture_it_is_given():
    pose = probe_pose(X_WT=X_WT, x=0, y=0, yaw=0.3, height=0.0)
    swung = IIWA.home + np.array([0.4, 0, -0.4, 0, 0, 0, 0])
    near_home, near_swung = solve_posture(IIWA, pose), solve_posture(IIWA, pose, swung)
    assert abs(near_home[2]) < 0.2
    assert near_swung[2] < -0.2
    for q, to in ((near_home, IIWA.home), (near_swung, swung)):
        other = near_swung if q is near_home else near_home
        assert np.linalg.norm(q - to) < np.linalg.norm(other - to)


@pytest.mark.parametrize("arm", [VIPER, IIWA])
def test_a_pose_within_reach_is_found_from_any_posture(arm):
    pose = probe_pose(X_WT=X_WT, x=0, y=0, yaw=0.0, height=0.0)
    low, high = arm.plant.GetPositionLowerLimits(), arm.plant.GetPositionUpperLimits()
    for near in np.random.default_rng(5).uniform(low, high, (10, len(low))):
        q = solve_posture(arm, pose, near)
        assert (q >= low - 1e-6).all()
        assert (q <= high + 1e-6).all()
        context = arm.plant.CreateDefaultContext()
        arm.plant.SetPositions(context, q)
        got = arm.probe.EvalPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(got, pose.GetAsMatrix4(), atol=5e-5)
