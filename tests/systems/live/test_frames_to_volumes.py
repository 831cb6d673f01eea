import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from tracked_frames import PIXEL, SIZE, freehand, grey

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.live import MotorSweepParameters
from sonoservo.systems.live.connection.items import ImageItem
from sonoservo.systems.live.feeds import frame_items
from sonoservo.systems.live.frames_to_volumes import FramesToVolumes
from sonoservo.systems.live.image_matcher import PosedImage
from sonoservo.systems.live.motor_sweep import MotorSweepVolumes, load_motor_sweep
from sonoservo.systems.signals import ReconstructedVolume, Sweep, SweepMotion
from sonoservo.systems.ultrasound import (
    ImagingParameters,
    ScanConversion,
    ScanConversionParameters,
    make_grid,
)
from sonoservo.systems.ultrasound.frame_reconstruction import reconstruct


def posed(pixels, X_WL, time, X_LI=PIXEL):
    return PosedImage(ImageItem("F", time, pixels[..., np.newaxis], X_LI), X_WL, None, time, 0.0)


def test_freehand_frames_become_a_volume_at_every_turn():
    frames = freehand(30, turns=1, dtype=np.uint8)
    maker, volumes = FramesToVolumes(), []
    shift = np.eye(4)
    shift[0, 3] = -0.5 * PIXEL[0, 0] * (SIZE[0] - 1)
    for frame in frames:
        made = maker(posed(frame.pixels, frame.X_WF, frame.time, shift @ PIXEL))
        assert made or made.reason == ""
        volumes += [made] if made else []
    (volume,) = volumes
    assert isinstance(volume, ReconstructedVolume)
    expected = reconstruct(frames[: len(volume.frame_times)])
    np.testing.assert_array_equal(volume.frames, expected.frames)
    assert np.abs(volume.intensities.astype(int) - expected.intensities).max() <= 1


def test_frame_that_makes_no_sense_is_left_out():
    pixels = np.full(SIZE, np.nan, np.float32)
    assert "not seen" in FramesToVolumes()(posed(pixels, RigidTransform(), 0.0)).reason
    with pytest.raises(ValueError, match="frames"):
        FramesToVolumes(frames=1)


@pytest.fixture(scope="module")
def parameters():
    return MotorSweepParameters(
        imaging=ImagingParameters(),
        scan_conversion=ScanConversionParameters(spacing=[2e-3, 2e-3, 2e-3]),
        start=100.0,
    )


def play(maker, geometry, number, drop=()):
    """One sweep of random samples, sent frame by frame: the sweep and what came out."""
    direction = -1 if number % 2 else 1
    rng = np.random.default_rng(number)
    samples = rng.integers(0, 255, geometry.shape, dtype=np.uint8)
    order = np.arange(geometry.frames)[::direction]
    times = 100.0 + geometry.frame_period * (number * geometry.frames + order)
    poses = [RigidTransform(RollPitchYaw(0.001 * k, 0, 0), [0, 0, 1e-4 * k]) for k in order]
    motion = SweepMotion(geometry, direction, times, np.array([X.GetAsMatrix4() for X in poses]))
    sweep = Sweep(samples, motion)
    items = frame_items(sweep)
    made = [
        maker(PosedImage(image, pose.X, None, image.time, 0.0))
        for k, (pose, image) in enumerate(zip(items[::2], items[1::2], strict=True))
        if k not in drop
    ]
    return sweep, made


def test_samples_become_the_sweep_and_its_volume_again(parameters):
    maker = MotorSweepVolumes(parameters)
    geometry = maker.geometry
    conversion = ScanConversion(geometry, make_grid(geometry, 2e-3))
    for number in range(2):
        sweep, made = play(maker, geometry, number)
        assert [bool(each) for each in made] == [False] * (geometry.frames - 1) + [True]
        expected = conversion(sweep)
        np.testing.assert_array_equal(made[-1].intensities, expected.intensities)
        np.testing.assert_array_equal(made[-1].motion.times, sweep.motion.times)
        np.testing.assert_array_equal(made[-1].motion.X_WP, sweep.motion.X_WP)
        assert made[-1].motion.direction == sweep.motion.direction


def test_sweep_with_a_missing_frame_is_left_out(parameters):
    maker = MotorSweepVolumes(parameters)
    _, made = play(maker, maker.geometry, 0, drop=(3,))
    assert not any(made)
    _, made = play(maker, maker.geometry, 1)
    assert made[0].reason == "a sweep lacks 1 frames"
    assert made[-1]


def test_pictures_are_placed_by_the_angle_of_the_motor(parameters):
    maker = MotorSweepVolumes(parameters)
    geometry = maker.geometry
    X_PI = PIXEL.copy()
    X_PI[:2, 3] = -0.5 * PIXEL[0, 0] * (SIZE[0] - 1), 0.01
    i, j = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]), indexing="ij")
    made = None
    for k, angle in enumerate(geometry.line_angles(1).mean(axis=1)):
        x, y = X_PI[0, 0] * i + X_PI[0, 3], X_PI[1, 1] * j + X_PI[1, 3]
        rho = y + geometry.motor_radius
        p_P = np.stack(
            [x, rho * np.cos(angle) - geometry.motor_radius, rho * np.sin(angle)], axis=-1
        )
        pixels = grey(p_P).astype(np.float32)
        made = maker(posed(pixels, RigidTransform(), 100.0 + geometry.frame_period * k, X_PI))
    index = np.argwhere(~made.holes)
    p_W, _ = made.to_world(made.position(index))
    assert len(index) > 1000
    np.testing.assert_allclose(made.intensities[tuple(index.T)], grey(p_W), atol=0.2)


def test_motor_is_read_from_a_file(tmp_path):
    path = tmp_path / "motor.yaml"
    path.write_text("probe: 4dc7_3_40\nstart: 1.5\nboth_ways: false\n")
    assert load_motor_sweep(path).start == 1.5
    path.write_text("start: now\n")
    with pytest.raises(ConfigurationError, match=r"motor\.yaml.*start"):
        load_motor_sweep(path)
    path.write_text("begin: 1\n")
    with pytest.raises(ConfigurationError, match="begin"):
        load_motor_sweep(path)
