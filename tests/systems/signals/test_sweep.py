import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonoservo.systems.signals.sweep import SweepGeometry, SweepMotion
from sonoservo.systems.ultrasound.scan_conversion import make_grid

CONVEX = {
    "array_radius": 0.040, "motor_radius": 0.02725, "line_pitch": np.deg2rad(0.608768),
    "frame_pitch": np.deg2rad(1.463), "sample_pitch": 0.308e-3, "lines": 96, "frames": 27,
    "samples": 293, "frame_period": 0.0113,
}  # fmt: skip
SECTOR = CONVEX | {"array_radius": 0.0, "motor_radius": 0.0}

geometries = st.sampled_from([SweepGeometry(**CONVEX), SweepGeometry(**SECTOR)])
directions = st.sampled_from([1, -1])
fractions = st.floats(0.01, 0.99)


@given(geometries, directions, fractions, fractions, fractions)
def test_index_inverts_position(geometry, direction, a, b, c):
    index = np.array([a, b, c]) * (np.array(geometry.shape) - 1)
    p_P = geometry.position(*index, direction)
    assert np.allclose(geometry.index(p_P, direction), index, atol=1e-6)


def test_middle_of_the_face_is_the_origin_and_depth_is_along_y():
    geometry = SweepGeometry(**CONVEX)
    k, j = (geometry.frames - 1) / 2, (geometry.lines - 1) / 2
    p_P = geometry.position(k, j, [0, 100], 1)
    assert np.allclose(p_P, [[0, 0, 0], [0, 100 * 0.308e-3, 0]], atol=1e-9)


def test_face_is_an_arc_about_the_arrays_centre_of_curvature():
    geometry = SweepGeometry(**CONVEX)
    # Close to the plane theta = 0 the face lies 40 mm from its centre of curvature.
    middle = (geometry.frames - 1) / 2
    p_P = geometry.position(middle, np.arange(96), 0, 1)
    q = np.hypot(p_P[:, 1] + 0.02725, p_P[:, 2]) + 0.01275
    assert np.allclose(np.hypot(p_P[:, 0], q), 0.040)


@given(directions)
def test_motor_moves_steadily_from_line_to_line(direction):
    geometry = SweepGeometry(**CONVEX)
    in_order = geometry.line_angles(direction)[::direction].ravel()  # a -Z sweep ends at frame 0
    step = geometry.frame_pitch * 27 / (27 * 96 - 1)
    assert np.allclose(np.diff(in_order), direction * step)


def test_sound_needs_time():
    least = 96 * 2 * 292 * 0.308e-3 / 1540
    assert SweepGeometry(**CONVEX).min_frame_period == pytest.approx(least)
    with pytest.raises(ValueError, match=r"frame_period: 0\.01 is not allowed.*96 lines"):
        SweepGeometry(**CONVEX | {"frame_period": 0.010})


def test_contains_only_what_both_directions_sweep():
    geometry = SweepGeometry(**CONVEX)
    corner = geometry.position(0, 0, 100, 1)  # the first line of a sweep towards +Z
    assert not geometry.contains(corner)
    assert geometry.contains(geometry.position(13, 47, 100, 1))
    assert not geometry.contains(np.array([0, -0.001, 0]))


@pytest.mark.parametrize("direction", [1, -1])
def test_to_world_uses_each_frames_own_pose_and_time(direction):
    geometry = SweepGeometry(**CONVEX)
    X_WP = np.repeat(np.eye(4)[np.newaxis], 27, axis=0)
    X_WP[:, 0, 3] = 1e-3 * np.arange(27)  # the probe moves 1 mm a frame along X
    times = 2 + 0.0113 * np.arange(27)[::direction]
    motion = SweepMotion(geometry, direction, times, X_WP)
    k = np.array([0.0, 3.5, 26.0])
    p_P = geometry.position(k, 40, 150, direction)
    p_W, t = motion.to_world(p_P)
    assert np.allclose(p_W - p_P, np.outer(1e-3 * k, [1, 0, 0]), atol=1e-9)
    assert np.allclose(t, np.interp(k, np.arange(27), times))
    assert motion.time == pytest.approx(2 + 0.0113 * 13)


def test_a_sweep_of_one_frame_has_one_time_and_pose_and_makes_no_volume():
    geometry = SweepGeometry(**CONVEX | {"frames": 1})
    X_WP = np.eye(4)[np.newaxis].copy()
    X_WP[0, :3, 3] = [0.1, 0.2, 0.3]
    motion = SweepMotion(geometry, 1, np.array([4.0]), X_WP)
    p_W, times = motion.to_world([[0.0, 0.05, 0.0], [0.01, 0.06, 0.001]])
    assert np.allclose(p_W, [[0.1, 0.25, 0.3], [0.11, 0.26, 0.301]])
    assert np.allclose(times, 4.0)
    with pytest.raises(ValueError, match="frames: 1"):
        make_grid(geometry, 1e-3)
