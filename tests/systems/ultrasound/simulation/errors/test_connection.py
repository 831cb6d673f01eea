import numpy as np
import pytest

from sonoservo.systems.ultrasound.simulation.errors import (
    ConnectionParameters,
    Reception,
    repeat_lost_frames,
)

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


def test_quick_program_processes_every_sweep_at_its_arrival():
    assert processed([1, 2, 3], 0.0, 4) == [(1, 0), (2, 1), (3, 2)]
    assert processed([1, 2, 3], 0.5, 4) == [(1.5, 0), (2.5, 1), (3.5, 2)]


def test_slow_program_takes_the_newest_and_drops_the_rest():
    # Busy from 1 to 2.5, 2.5 to 4, 4 to 5.5 ...: the newest at 4 is the one that arrives then.
    assert processed(range(1, 9), 1.5, 9) == [(2.5, 0), (4, 1), (5.5, 3), (7, 4), (8.5, 6)]


def test_sweep_overtaken_by_a_newer_one_is_dropped():
    assert processed([1, 3.5, 3], 0.0, 5) == [(1, 0), (3, 2)]


@pytest.mark.parametrize(
    ("field", "value"), [("lost_frames", 1.0), ("lost_sweeps", -0.1), ("lateness", -1.0)]
)
def test_a_parameter_out_of_range_is_named(field, value):
    with pytest.raises(ValueError, match=field):
        ConnectionParameters(**{field: value})
