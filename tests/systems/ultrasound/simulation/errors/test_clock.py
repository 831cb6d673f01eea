import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.ultrasound.simulation.errors import ClockParameters, poses_at


def test_stamps():
    assert ClockParameters(offset=-0.02, drift=1e-3).stamp(30.0) == pytest.approx(30.01)
    times = np.array([0.1, 0.2, 0.3])
    np.testing.assert_array_equal(ClockParameters().stamp(times), times)
    assert ClockParameters().is_right
    assert not ClockParameters(drift=1e-6).is_right


def test_poses_between_two_lie_on_the_shortest_way_and_beyond_all_are_the_nearest():
    X = [RigidTransform(RotationMatrix.MakeYRotation(a), [a, 0, 0]) for a in (0.0, 0.2, 0.6)]
    found = poses_at(np.array([-1.0, 1.0, 1.25, 1.5, 9.0]), [1.0, 1.5, 2.0], X)
    for pose, angle in zip(found, (0.0, 0.0, 0.1, 0.2, 0.6), strict=True):
        expected = RigidTransform(RotationMatrix.MakeYRotation(angle), [angle, 0, 0])
        np.testing.assert_allclose(pose, expected.GetAsMatrix4(), atol=1e-12)


@pytest.mark.parametrize(("field", "value"), [("offset", 2.0), ("offset", np.nan), ("drift", 1.0)])
def test_a_parameter_out_of_range_is_named(field, value):
    with pytest.raises(ValueError, match=f"{field}: .* must be from"):
        ClockParameters(**{field: value})
