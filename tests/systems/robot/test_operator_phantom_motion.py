import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from sonoservo.systems.robot import Breathing, OperatorPhantomMotion, PhantomMotionParameters
from sonoservo.systems.robot.phantom_motion import phantom_trajectory

X_WT = RigidTransform([0.5, 0.0, 0.2])
SPEED = (0.04, 0.04, 0.015, 30.0, 30.0, 30.0)


@pytest.mark.parametrize("breathes", [False, True])
def test_a_flood_of_targets_becomes_moves_that_give_the_same_motion(breathes):
    rng = np.random.default_rng(0)
    breathing = Breathing(peak_to_peak=0.01, direction=[0, 1, 0]) if breathes else Breathing()
    motion = OperatorPhantomMotion(X_WT=X_WT, breathing=breathing)
    simulator = Simulator(motion)
    context = simulator.get_mutable_context()
    times, seen = np.arange(0, 9, 1 / 100), []
    for time in times:
        target = rng.uniform(-0.03, 0.03, 4) if time < 6 else [0.02, -0.01, 0.005, 0.2]
        motion.GetInputPort("phantom_target").FixValue(context, target)
        simulator.AdvanceTo(time)
        seen.append(motion.GetOutputPort("phantom_command").Eval(context).copy())
    moves = motion.moves(context)
    assert 3 < len(moves) < 20
    repeated = PhantomMotionParameters(moves=moves, breathing=breathing)
    trajectory = phantom_trajectory(repeated, X_WT)
    for time, command in zip(times, seen, strict=True):
        np.testing.assert_allclose(command[:6], trajectory.value(time).ravel(), atol=1e-12)
        np.testing.assert_allclose(command[6:], trajectory.EvalDerivative(time).ravel(), atol=1e-12)
    if breathes:
        return
    # From rest to rest the highest speed is half as high again as the mean.
    assert (np.abs(seen)[:, 6:9].max(axis=0) <= 1.5 * np.array(SPEED[:3]) + 1e-9).all()
    np.testing.assert_allclose(seen[-1], [0.52, -0.01, 0.205, 0, 0, 0.2, *6 * [0]], atol=1e-8)
