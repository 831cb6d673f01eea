import numpy as np
import pytest
from renderers import DEEP, DOWN, NOWHERE

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.acquisition import acquire_sweep
from sonoservo.systems.ultrasound.simulation.errors import (
    ConnectionParameters,
    MotorParameters,
    motor_error,
    turned,
)
from sonoservo.systems.ultrasound.simulation.rendering import SweepRenderer
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.transducer import Transducer

RNG = np.random.default_rng


def test_backlash_lags_behind_either_way_and_errors_have_their_deviation():
    play = MotorParameters(backlash_deg=0.6)
    np.testing.assert_allclose(np.rad2deg(motor_error(play, 5, 1, RNG(0))), -0.3)
    np.testing.assert_allclose(np.rad2deg(motor_error(play, 5, -1, RNG(0))), 0.3)
    errors = np.rad2deg(motor_error(MotorParameters(error_deg=0.2), 5000, 1, RNG(0)))
    assert errors.std() == pytest.approx(0.2, rel=0.05)
    assert abs(np.corrcoef(errors[1:], errors[:-1])[0, 1]) < 0.06


def test_motor_of_a_single_frame_rests():
    assert motor_error(MotorParameters(backlash_deg=1.0, error_deg=1.0), 1, 1, RNG(0)) == [0.0]


def make_renderer(**errors):
    return SweepRenderer(
        transducer=Transducer(),
        imaging=ImagingParameters(sector=0.1, frames=27, volume_rate=3.3),
        tissue=DEEP,
        parameters=ScannerParameters(**errors),
        seed=0,
    )


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


@pytest.mark.parametrize("field", ["backlash_deg", "error_deg"])
def test_a_parameter_out_of_range_is_named(field):
    with pytest.raises(ValueError, match=f"{field}: -1 .* at least 0"):
        MotorParameters(**{field: -1})
