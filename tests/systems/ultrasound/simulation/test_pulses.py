"""Poses of frames and rays of lines, held against the geometry that places the samples."""

import numpy as np
import pytest
from renderers import make_renderer, still

from sonoservo.systems.ultrasound.simulation.pulses import frame_poses, line_rays


@pytest.fixture(scope="module")
def renderer():
    return make_renderer()


@pytest.mark.parametrize("direction", [1, -1])
def test_rays_pass_through_their_samples(renderer, direction):
    geometry = renderer.geometry
    start, along = line_rays(geometry, direction)
    np.testing.assert_allclose(np.linalg.norm(along, axis=-1), 1)
    frames, lines, samples = np.ogrid[: geometry.frames, : geometry.lines, :200:50]
    expected = geometry.position(frames, lines, samples, direction)
    depths = geometry.sample_pitch * np.arange(0, 200, 50)[:, np.newaxis]
    at = start[:, :, np.newaxis] + depths * along[:, :, np.newaxis]
    np.testing.assert_allclose(at, expected, atol=1e-12)


def test_the_middle_line_of_a_frame_lies_in_the_plane_of_its_pose(renderer):
    geometry = renderer.geometry
    X_TP = still(renderer)
    X_FT = frame_poses(geometry, X_TP, slice(None))
    middle = (geometry.lines - 1) / 2
    for frame in (0, 13, geometry.frames - 1):
        p_P = geometry.position(frame, middle, np.array([0, 100]), 1)
        p_T = p_P @ X_TP[frame, :3, :3].T + X_TP[frame, :3, 3]
        p_F = p_T @ X_FT[frame, :, :3].T + X_FT[frame, :, 3]
        np.testing.assert_allclose(p_F[:, [0, 2]], 0, atol=1e-9)


def test_some_frames_have_the_poses_that_they_have_in_the_whole_sweep(renderer):
    geometry, part = renderer.geometry, slice(3, 9)
    X_TP = still(renderer)
    some = frame_poses(geometry, X_TP[part], part)
    np.testing.assert_array_equal(some, frame_poses(geometry, X_TP, slice(None))[part])
