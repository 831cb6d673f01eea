import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.robot import Breathing, Move, PhantomMotionParameters
from sonoservo.systems.robot.phantom_motion import phantom_trajectory


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


def test_overlapping_moves_are_refused():
    with pytest.raises(ValueError, match=r"moves: 0\.5 is not allowed"):
        PhantomMotionParameters(moves=[Move(start=0.0, duration=1.0), Move(start=0.5)])


def test_breathing_adds_to_the_moves_along_its_direction():
    breathing = Breathing(peak_to_peak=0.01, rate=0.25, direction=[0, 3, 4])
    moves = [Move(start=2.0, duration=0.5, translation=[0.04, 0.0, 0.0])]
    trajectory = phantom_trajectory(
        PhantomMotionParameters(moves=moves, breathing=breathing), RigidTransform([0.5, 0, 0.2])
    )
    for time, share in [(0.0, 0.0), (1.0, 0.5), (2.0, 1.0), (3.0, 0.5), (4.0, 0.0), (402.0, 1.0)]:
        moved = 0.04 if time > 2.4 else 0.0
        expected = [0.5 + moved, 0.006 * share, 0.2 + 0.008 * share, 0, 0, 0]
        np.testing.assert_allclose(trajectory.value(time).ravel(), expected, atol=1e-12)
    for time in (0.0, 1.3, 2.2, 7.7):
        slope = (trajectory.value(time + 1e-5) - trajectory.value(time - 1e-5)) / 2e-5
        np.testing.assert_allclose(trajectory.EvalDerivative(time), slope, atol=1e-7)


def test_breath_with_a_larger_exponent_rests_longer():
    breaths = [Breathing(peak_to_peak=0.01, exponent=n) for n in (1, 2, 4)]
    times = np.linspace(0, 4, 401)
    resting = [np.mean([each.displacement(t)[0] < 1e-3 for t in times]) for each in breaths]
    assert (np.diff(resting) > 0.05).all()
