import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RotationMatrix
from scipy.linalg import expm

from sonoservo.systems.control import needle_features
from sonoservo.systems.control.visual_features import interaction_matrix, saturated

lengths = st.floats(-0.1, 0.1)
angles = st.floats(-np.pi / 2 + 0.01, np.pi / 2 - 0.01)


def moved(X_WP: RigidTransform, velocity, time: float) -> RigidTransform:
    """Pose after a constant velocity (v_x, v_z, omega_y) of P in P: the matrix exponential."""
    v_x, v_z, omega_y = velocity
    twist = np.zeros((4, 4))
    twist[0, 2], twist[2, 0] = omega_y, -omega_y
    twist[0, 3], twist[2, 3] = v_x, v_z
    return RigidTransform(X_WP.GetAsMatrix4() @ expm(time * twist))


def features_from(X_WP: RigidTransform, p_W, k_W):
    X_PW = X_WP.inverse()
    return needle_features(X_PW.multiply(p_W), X_PW.rotation().multiply(k_W))


@given(x=lengths, y=lengths, z=lengths, theta=angles, depth=st.floats(-2, 2))
def test_features_do_not_depend_on_the_needles_sense(x, y, z, theta, depth):
    tip, direction = np.array([x, y, z]), np.array([np.cos(theta), depth, np.sin(theta)])
    features = needle_features(tip, direction)
    np.testing.assert_allclose(features, [x, z, theta], atol=1e-12)
    np.testing.assert_allclose(needle_features(tip, -3 * direction), features, atol=1e-12)


@given(
    tip=st.tuples(lengths, lengths, lengths),
    theta=st.floats(-1.4, 1.4), dip=st.floats(-1, 1), velocity=st.tuples(*3 * [st.floats(-1, 1)]),
)  # fmt: skip
def test_interaction_matrix_is_the_derivative_of_the_features(tip, theta, dip, velocity):
    X_WP = RigidTransform(RotationMatrix.MakeXRotation(-1.2), [0.3, 0.2, 0.5])
    p_W = X_WP.multiply(tip)
    k_W = X_WP.rotation().multiply([np.cos(theta), dip, np.sin(theta)])
    h = 1e-5
    ahead, behind = (features_from(moved(X_WP, velocity, t), p_W, k_W) for t in (h, -h))
    L = interaction_matrix(features_from(X_WP, p_W, k_W))
    np.testing.assert_allclose((ahead - behind) / (2 * h), L @ velocity, atol=1e-7)


@given(velocity=st.tuples(*3 * [st.floats(-5, 5)]))
def test_saturation_keeps_the_direction_and_the_limits(velocity):
    velocity = np.array(velocity)
    slowed = saturated(velocity, speed=0.03, angular_speed=0.4)
    assert np.hypot(*slowed[:2]) <= 0.03 * (1 + 1e-12)
    assert abs(slowed[2]) <= 0.4 * (1 + 1e-12)
    np.testing.assert_allclose(np.cross(slowed, velocity), 0, atol=1e-12)
    if np.hypot(*velocity[:2]) <= 0.03 and abs(velocity[2]) <= 0.4:
        np.testing.assert_array_equal(slowed, velocity)
    assume(np.abs(velocity).max() > 1e-6)
    assert slowed @ velocity > 0
