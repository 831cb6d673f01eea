"""Errors of a scanner's clock and motor, and of the connection that its sweeps come by."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix
from renderers import DEEP, DOWN, NOWHERE

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.errors import (
    ClockParameters,
    ConnectionParameters,
    MotorParameters,
    Reception,
    motor_error,
    poses_at,
    repeat_lost_frames,
    turned,
)
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.transducer import Transducer


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


SAMPLES = np.arange(9, dtype=np.uint8).repeat(6).reshape(9, 2, 3)


@pytest.mark.parametrize("direction", [1, -1])
def test_frame_lost_shows_the_one_acquired_before(direction):
    rng = np.random.default_rng(4)
    shown = repeat_lost_frames(SAMPLES, 0.4, direction, rng)[::direction, 0, 0].astype(int)
    acquired = np.arange(9)[::direction]
    assert shown[0] == acquired[0]
    kept = shown == acquired
    assert 0 < (~kept).sum() < 9
    for k in np.flatnonzero(~kept):
        assert shown[k] == shown[k - 1]


def test_losses_and_lateness_have_their_rates():
    parameters = ConnectionParameters(lost_sweeps=0.05, lateness=0.1)
    rng = np.random.default_rng(0)
    lost = np.mean([parameters.is_lost(rng) for _ in range(10000)])
    assert lost == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 10000))
    late = np.array([parameters.late(rng) for _ in range(10000)])
    assert late.mean() == pytest.approx(0.1, rel=0.05)
    assert np.mean(late > 0.1) == pytest.approx(np.exp(-1), abs=0.02)
    many = np.tile(SAMPLES, (500, 1, 1))
    frames = np.arange(len(many), dtype=np.uint8).reshape(-1, 1, 1)
    repeated = np.mean(repeat_lost_frames(frames, 0.2, 1, rng)[:, 0, 0] != frames[:, 0, 0])
    assert repeated == pytest.approx(0.2, abs=0.03)


def processed(arrivals, processing_time, until, step=1 / 64):
    """Time at which each sweep is processed: (time, number)."""
    reception, seen = Reception(), []
    for number, arrival in enumerate(arrivals):
        reception = reception.sent(number, arrival)
    for time in np.arange(0, until, step):
        reception = reception.at(time, processing_time)
        if reception.processed is not None and (not seen or seen[-1][1] != reception.processed):
            seen.append((float(time), reception.processed))
    return seen


@pytest.mark.parametrize(
    ("arrivals", "processing_time", "expected"),
    [
        ([1, 2, 3], 0.5, [(1.5, 0), (2.5, 1), (3.5, 2)]),
        # Busy from 1 to 2.5, 2.5 to 4, 4 to 5.5: the newest at 4 is the one that arrives then.
        (range(1, 9), 1.5, [(2.5, 0), (4, 1), (5.5, 3), (7, 4), (8.5, 6)]),
        ([1, 3.5, 3], 0.0, [(1, 0), (3, 2)]),
    ],
    ids=["in time", "too slow", "overtaken"],
)
def test_the_newest_sweep_is_processed_and_older_ones_are_dropped(
    arrivals, processing_time, expected
):
    assert processed(arrivals, processing_time, 9) == expected


def test_backlash_lags_behind_either_way_and_errors_have_their_deviation():
    play = MotorParameters(backlash_deg=0.6)
    np.testing.assert_allclose(np.rad2deg(motor_error(play, 5, 1, np.random.default_rng(0))), -0.3)
    np.testing.assert_allclose(np.rad2deg(motor_error(play, 5, -1, np.random.default_rng(0))), 0.3)
    rng = np.random.default_rng(0)
    errors = np.rad2deg(motor_error(MotorParameters(error_deg=0.2), 5000, 1, rng))
    assert errors.std() == pytest.approx(0.2, rel=0.05)
    assert abs(np.corrcoef(errors[1:], errors[:-1])[0, 1]) < 0.06


def make_renderer(**errors):
    imaging = ImagingParameters(sector=0.1, frames=27, volume_rate=3.3)
    return SweepRenderer(
        transducer=Transducer(), imaging=imaging, tissue=DEEP,
        parameters=ScannerParameters(**errors), seed=0,
    )  # fmt: skip


def acquire(renderer, needle=NOWHERE, direction=1, number=0):
    motion = SweepMotion(renderer.geometry, direction, np.zeros(27), np.tile(DOWN, (27, 1, 1)))
    return acquire_sweep(renderer, motion, [needle] * 27, number=number)


def test_turned_poses_show_each_frame_at_another_angle():
    """A turn by whole frames shows the frames beside."""
    renderer = make_renderer()
    geometry = renderer.geometry
    X, times = np.tile(DOWN, (27, 1, 1)), np.zeros(27)
    pitch = geometry.frame_pitch * geometry.frames / (geometry.frames - 1 / geometry.lines)
    ahead = turned(X, np.full(27, 2 * pitch), geometry)
    moved, still = (renderer.tissue_echo(each, 1, times) for each in (ahead, X))
    error = np.abs(moved[:-2] - still[2:]).max() / np.abs(still).max()
    assert error < 0.02


def centre(sweep):
    """Angle of a needle along X about the motor's axis, in deg, by the middle lines."""
    geometry = sweep.geometry
    middle = slice(geometry.lines // 2 - 1, geometry.lines // 2 + 1)
    # The needle lies 50 mm deep; amplitudes above the tissue.
    rows = slice(int(0.045 / geometry.sample_pitch), int(0.055 / geometry.sample_pitch))
    level = sweep.samples[:, middle, rows].astype(float).max(axis=2) * sweep.decibels_per_level
    amplitude = 10 ** (level / 20) * (level > level.max() - 12)
    angle = np.rad2deg(geometry.line_angles(sweep.motion.direction)[:, middle])
    return float((amplitude * angle).sum() / amplitude.sum())


def test_backlash_separates_sweeps_to_and_fro():
    """Hysteresis: the same needle appears by the whole play apart."""
    needle = Needle(np.array([[-0.04, 0.0, -0.15], [0.04, 0.0, -0.15]]), 0.635e-3)
    for play in (0.0, 1.2):
        renderer = make_renderer(motor=MotorParameters(backlash_deg=play))
        forth, back = (centre(acquire(renderer, needle, direction)) for direction in (1, -1))
        assert forth - back == pytest.approx(play, abs=0.12)
        assert forth + back == pytest.approx(0, abs=0.2)


def test_lost_frames_repeat_in_a_sweep():
    whole = acquire(make_renderer()).samples
    sweep = acquire(make_renderer(connection=ConnectionParameters(lost_frames=0.3))).samples
    same = np.array([(frame == sweep[k]).all() for k, frame in enumerate(whole)])
    assert same[0]
    assert 2 <= (~same).sum() <= 16
    for k in np.flatnonzero(~same):
        np.testing.assert_array_equal(sweep[k], sweep[k - 1])
