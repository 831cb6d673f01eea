import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.robot.phantom_motion import Move, PhantomMotionParameters, phantom_trajectory


def test_moves_add_up_and_start_and_end_at_rest():
    trajectory = phantom_trajectory(
        PhantomMotionParameters(
            moves=[
                Move(start=2.0, duration=0.5, translation=[0.04, 0.0, 0.01]),
                Move(start=2.5, duration=0.5, rotation_deg=[0.0, 0.0, 20.0]),
                Move(start=6.0, duration=1.0, translation=[-0.04, 0.0, 0.0]),
            ]
        ),
        RigidTransform([0.5, 0.1, 0.2]),
    )
    yaw = np.deg2rad(20)
    for time, expected in [
        (0.0, [0, 0, 0, 0, 0, 0]),
        (2.25, [0.02, 0, 0.005, 0, 0, 0]),
        (2.5, [0.04, 0, 0.01, 0, 0, 0]),
        (5.0, [0.04, 0, 0.01, 0, 0, yaw]),
        (500.0, [0, 0, 0.01, 0, 0, yaw]),
    ]:
        rest = np.array([0.5, 0.1, 0.2, 0, 0, 0])
        np.testing.assert_allclose(trajectory.value(time).ravel(), rest + expected, atol=1e-12)
    for time in (0.0, 2.0, 2.5, 3.0, 4.0, 6.0, 7.0, 8.0):
        np.testing.assert_allclose(trajectory.EvalDerivative(time, 1), 0, atol=1e-9)


def test_without_moves_it_rests():
    trajectory = phantom_trajectory(PhantomMotionParameters(), RigidTransform([1, 2, 3]))
    np.testing.assert_array_equal(trajectory.value(10.0).ravel(), [1, 2, 3, 0, 0, 0])


def test_overlapping_moves_are_refused():
    with pytest.raises(ValueError, match=r"moves: 0\.5 is not allowed"):
        PhantomMotionParameters(moves=[Move(start=0.0, duration=1.0), Move(start=0.5)])
