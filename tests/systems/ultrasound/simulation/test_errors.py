"""Errors of a scanner's clock and motor, and of the connection that its sweeps come by."""

import numpy as np
import pytest
from renderers import DEEP, DOWN, NOWHERE

from sonoservo.systems.signals import Needle, SweepMotion
from sonoservo.systems.ultrasound import ImagingParameters, Transducer
from sonoservo.systems.ultrasound.simulation import (
    ConnectionParameters,
    MotorParameters,
    ScannerParameters,
    SweepRenderer,
    acquire_sweep,
)
from sonoservo.systems.ultrasound.simulation.errors import (
    Reception,
    motor_error,
)


def test_lateness_is_exponentially_distributed():
    rng = np.random.default_rng(0)
    late = np.array([ConnectionParameters(lateness=0.1).late(rng) for _ in range(10000)])
    assert late.mean() == pytest.approx(0.1, rel=0.05)
    assert np.mean(late > 0.1) == pytest.approx(np.exp(-1), abs=0.02)


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


def test_errors_of_the_motor_have_their_deviation_and_are_independent():
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


@pytest.mark.parametrize("direction", [1, -1])
def test_a_lost_frame_shows_the_one_acquired_before(direction):
    lossy = make_renderer(connection=ConnectionParameters(lost_frames=0.3))
    whole, sweep = (
        acquire(each, direction=direction).samples[::direction] for each in (make_renderer(), lossy)
    )
    same = np.array([(frame == sweep[k]).all() for k, frame in enumerate(whole)])
    assert same[0]
    assert 2 <= (~same).sum() <= 16
    for k in np.flatnonzero(~same):
        np.testing.assert_array_equal(sweep[k], sweep[k - 1])
