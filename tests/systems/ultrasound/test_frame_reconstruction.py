import numpy as np
import pytest
from pydrake.math import RigidTransform
from tracked_frames import freehand, grey, look

from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame, SweepSplitter, reconstruct


def seen_voxels(volume):
    index = np.argwhere(~volume.holes)
    return index, volume.position(index)


@pytest.fixture(scope="module")
def volume():
    return reconstruct(freehand())


def test_every_voxel_shows_what_is_at_its_place_in_the_world(volume):
    index, p_P = seen_voxels(volume)
    assert len(index) > 0.5 * volume.frames.size
    p_W, _ = volume.to_world(p_P)
    np.testing.assert_allclose(volume.intensities[tuple(index.T)], grey(p_W), atol=0.02)


def test_time_and_pose_of_a_voxel_are_those_of_the_frames_that_saw_it(volume):
    frames = freehand()
    _, p_P = seen_voxels(volume)
    some = slice(None, None, 97)
    p_W, times = volume.to_world(p_P[some])
    for position, number, time in zip(p_W, volume.frame_at(p_P[some]), times, strict=True):
        near = int(number)
        assert time == pytest.approx(10 + 0.05 * number, abs=1e-4)
        # It lies between the planes of the two frames.
        distances = [
            frames[k].X_WF.inverse().multiply(position)[2] for k in (near, min(near + 1, 29))
        ]
        assert distances[0] * distances[1] <= 1e-10
        pose = RigidTransform(volume.frame_poses[near])
        assert pose.IsNearlyEqualTo(frames[near].X_WF, 1e-12)


def test_where_no_frame_passed_it_is_marked_and_black(volume):
    assert volume.holes.any()
    assert not volume.intensities[volume.holes].any()
    outside = volume.position([[-5, 0, 0]])
    assert np.isnan(volume.frame_at(outside)).all()
    assert volume.to_world(outside)[1] == [volume.time]


def test_gap_that_is_too_wide_stays_a_hole():
    frames = freehand()
    gap = frames[:12] + frames[18:]
    narrow, wide = reconstruct(gap, max_gap=3e-3), reconstruct(gap, max_gap=10e-3)
    assert narrow.holes.sum() > wide.holes.sum() + 1000
    index, p_P = seen_voxels(wide)
    p_W, _ = wide.to_world(p_P)
    np.testing.assert_allclose(wide.intensities[tuple(index.T)], grey(p_W), atol=0.3)  # they tilt


def test_parallel_frames_are_taken_over_exactly():
    """Frames that lie on the grid's planes, pixel on voxel, are the volume."""
    rng = np.random.default_rng(100)
    pixels = rng.integers(0, 255, (9, 20, 30), dtype=np.uint8)
    frames = []
    for k, each in enumerate(pixels):
        X_WI = np.diag([1e-3, 1e-3, 1e-3, 1.0])
        X_WI[2, 3] = 1e-3 * k
        frames.append(PosedFrame(each, X_WI, float(k)))
    volume = reconstruct(frames, spacing=1e-3)
    assert not volume.holes.any()
    np.testing.assert_array_equal(volume.intensities, pixels.transpose(1, 2, 0))
    np.testing.assert_allclose(volume.frames[0, 0], np.arange(9), atol=1e-5)


@pytest.mark.parametrize(
    ("frames", "options", "message"),
    [
        (freehand()[:1], {}, "at least 2"),
        (freehand(), {"spacing": 1e-5}, "too many"),
        (freehand(), {"max_gap": -1.0}, "max_gap"),
        ([freehand()[0], PosedFrame(np.zeros((3, 3), np.uint8), np.eye(4), 11)], {}, "one size"),
    ],
)
def test_what_makes_no_volume_is_refused(frames, options, message):
    with pytest.raises(ValueError, match=message):
        reconstruct(frames, **options)


def test_sweeps_end_where_the_probe_turns_or_have_a_fixed_number_of_frames():
    splitter = SweepSplitter()
    sweeps = [s for frame in freehand(30, turns=2) if (s := splitter.add(frame))]
    sweeps.append(splitter.rest())
    assert [len(sweep) for sweep in sweeps] == pytest.approx([30, 30, 30], abs=1)
    ends = [sweep[-1].time for sweep in sweeps]
    assert ends == pytest.approx([11.45, 12.95, 14.45], abs=0.06)
    splitter = SweepSplitter(frames=12)
    sweeps = [s for frame in freehand(30) if (s := splitter.add(frame))]
    assert [len(sweep) for sweep in (*sweeps, splitter.rest())] == [12, 12, 6]


def test_probe_at_rest_makes_no_sweep_and_fills_no_memory():
    splitter = SweepSplitter()
    X = RigidTransform()
    assert not any(splitter.add(look(X, 0.1 * k)) for k in range(100))
    assert len(splitter._frames) < 20
    assert splitter.rest() == []
    with pytest.raises(ValueError, match="frames"):
        SweepSplitter(frames=1)
