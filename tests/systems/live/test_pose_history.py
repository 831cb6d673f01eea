import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.live.pose_history import PoseHistory


def pose(x, turn=0.0):
    return RigidTransform(RotationMatrix.MakeZRotation(turn), [x, 0, 0])


def test_pose_between_two_is_interpolated_along_the_shortest_turn():
    history = PoseHistory()
    history.add(1.0, pose(0.0, 3.0))
    history.add(1.2, pose(0.1, -3.0))
    halfway = history.at(1.1)
    assert halfway.IsNearlyEqualTo(pose(0.05, np.pi), 1e-9)
    assert history.at(1.2).IsExactlyEqualTo(pose(0.1, -3.0))


def test_pose_at_the_edge_is_the_nearest_and_beyond_or_in_a_long_gap_there_is_none():
    history = PoseHistory(tolerance=0.05)
    assert history.at(1.0).reason == "there is no pose yet"
    history.add(1.0, pose(0.1))
    assert history.at(1.04).IsExactlyEqualTo(pose(0.1))
    assert history.at(0.96).IsExactlyEqualTo(pose(0.1))
    assert "0.100 s away" in history.at(1.1).reason
    history = PoseHistory(max_gap=0.5)
    history.add(1.0, pose(0.0))
    history.add(2.0, pose(1.0))
    assert not history.at(1.5)


def test_late_pose_is_sorted_in_and_a_repeated_one_replaced():
    history = PoseHistory()
    for time, x in ((1.0, 0.0), (1.2, 2.0), (1.1, 5.0), (1.2, 3.0)):
        history.add(time, pose(x))
    assert len(history) == 3
    assert history.at(1.1).translation()[0] == 5.0
    assert history.at(1.15).translation()[0] == pytest.approx(4.0)


def test_clock_that_is_set_back_begins_anew():
    history = PoseHistory()
    history.add(1000.0, pose(0.0))
    history.add(1.0, pose(7.0))
    assert not history.reaches(2.0)
    assert history.reaches(1.0)
    assert len(history) == 1
