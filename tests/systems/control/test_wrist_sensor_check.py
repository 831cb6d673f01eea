import math
from dataclasses import replace

import numpy as np
import pytest

from sonoservo.systems.control.guard_parameters import WristSensorLimits
from sonoservo.systems.control.wrist_sensor_check import SensorFault, SensorMemory, next_memory

STEP = 0.005
LIMITS = WristSensorLimits()
NAN = 6 * (math.nan,)


def samples(count, pressing=2.0, seed=0):
    noise = 0.02 * np.random.default_rng(seed).standard_normal((count, 6))
    noise[:, 4:] += [pressing, 4.9]  # and the probe's weight
    return [tuple(each) for each in noise.tolist()]


def judge(readings, limits=LIMITS, moving=False):
    """Confirmed faults after each sample."""
    memory, faults = SensorMemory(), []
    for number, sample in enumerate(readings):
        memory = next_memory(memory, sample, sample[4], number * STEP, limits, moving=moving)
        faults.append(SensorFault(memory.fault))
    return faults


def test_a_good_sensor_is_believed():
    assert set(judge(samples(200))) == {SensorFault.NONE}


@pytest.mark.parametrize(
    ("bad", "fault"),
    [
        (NAN, SensorFault.NOT_FINITE),
        ((0, 0, 0, 0, math.inf, 0), SensorFault.NOT_FINITE),
        ((0, 0, 0, 0, 70.0, 0), SensorFault.OUT_OF_RANGE),
        ((0, -25.0, 0, 0, 2.0, 0), SensorFault.OUT_OF_RANGE),
    ],
)
def test_bad_samples_are_a_fault_if_they_last_and_forgiven_later(bad, fault):
    before, after = samples(20), samples(60, seed=1)
    assert judge([*before, bad, bad, *after])[-1] is SensorFault.NONE
    assert fault not in judge([*before, bad, bad, *after])
    faults = judge([*before, *6 * [bad], *after])
    assert faults[20 + 4] is fault
    settling = math.ceil(LIMITS.settling_time / STEP)
    assert faults[26 + settling - 2] is not SensorFault.NONE
    assert faults[26 + settling + 1] is SensorFault.NONE


def test_unchanged_samples_are_frozen_from_the_start_too():
    good = samples(20)
    assert judge([*good, *15 * [good[-1]]])[-1] is SensorFault.FROZEN
    assert judge(15 * [good[0]])[-1] is SensorFault.FROZEN
    assert judge([*good, *5 * [good[-1]]])[-1] is SensorFault.NONE
    patient = replace(LIMITS, frozen_after=0.0)
    assert set(judge([*good, *15 * [good[-1]]], patient)) == {SensorFault.NONE}


def test_a_jump_that_lasts_is_a_fault_and_a_spike_is_none():
    good, biased = samples(20), samples(40, pressing=-10.0)
    assert SensorFault.JUMPED in judge([*good, *biased])
    # The new level then shows a pull, which contact cannot exert.
    assert judge([*good, *biased])[-1] is SensorFault.PULLING
    spiked = [*good, *biased[:1], *samples(40, seed=2)]
    assert set(judge(spiked)) == {SensorFault.NONE}


@pytest.mark.parametrize("level", [7.0, -1.0, 4.9])
def test_a_step_of_a_steady_force_is_a_fault_until_nothing_is_felt(level):
    good, biased = samples(20), samples(40, pressing=level)
    faults = judge([*good, *biased, *samples(60, pressing=0.0, seed=2)])
    assert faults[20 + 4] is SensorFault.JUMPED
    # A level that a contact can have either way is not believed while it lasts.
    assert (faults[59] is SensorFault.JUMPED) == (level > LIMITS.max_pull)
    assert faults[-1] is SensorFault.NONE


def test_a_contact_that_grows_fast_is_no_fault():
    good = samples(20, pressing=0.0)
    for step in (0.5, 2.5, 4.0):
        levels = [0.0, *np.arange(1, 7) * step, *30 * [6 * step]]
        landing = [(*each[:4], each[4] + level, each[5]) for each, level in zip(
            samples(len(levels), pressing=0.0, seed=1), levels, strict=True
        )]  # fmt: skip
        assert set(judge([*good, *landing])) == {SensorFault.NONE}


def test_ignored_samples_are_counted():
    memory = SensorMemory()
    for number, sample in enumerate([*samples(20), NAN, NAN, *samples(40, seed=1)]):
        memory = next_memory(memory, sample, 2.0, number * STEP, LIMITS)
    assert (memory.ignored, memory.ignored_as) == (2, SensorFault.NOT_FINITE)


def test_a_sensor_that_jumps_to_and_fro_is_a_fault():
    good, off = samples(40), samples(40, pressing=22.0)
    alternating = [each for pair in zip(good, off, strict=True) for each in pair]
    faults = judge([*samples(20, seed=3), *alternating])
    assert faults[30] is SensorFault.JUMPED
    assert SensorFault.NONE not in faults[30:]


def test_a_pull_is_a_bias_unless_the_guard_itself_moves_the_probe():
    pulled = [*samples(20, pressing=0.0), *samples(20, pressing=-3.0)]
    assert judge(pulled)[-1] is SensorFault.PULLING
    assert judge(pulled, moving=True)[-1] is SensorFault.NONE


def test_the_first_sample_of_a_plant_that_has_not_moved_yet_is_no_jump():
    resting = [tuple(np.zeros(6))] * 2
    heavy = samples(20, pressing=-20.0)
    assert judge([*resting, *heavy], replace(LIMITS, max_pull=30.0))[-1] is SensorFault.NONE


def test_limits_must_be_positive():
    with pytest.raises(ValueError, match="max_jump: 0"):
        WristSensorLimits(max_jump=0)


def carried(count, rest):
    """Samples while the contact carries the probe's weight, but for a rest in N."""
    return [(*each[:4], each[4] - 2.0 + rest, each[5] - 4.9) for each in samples(count)]


def test_a_sensor_that_reads_nothing_for_long_is_dead():
    faults = judge([*carried(200, 0.0), *samples(60)])
    began = faults.index(SensorFault.DEAD)
    assert began == pytest.approx(LIMITS.dead_after / STEP, abs=4)
    assert faults[-1] is SensorFault.NONE
    for rest in (0.05, 0.1, 0.3):
        assert set(judge(carried(2000, rest))) == {SensorFault.NONE}
    assert SensorFault.DEAD not in judge(carried(200, 0.0), replace(LIMITS, dead_after=0.0))


@pytest.mark.parametrize("pressing", [0.6, 1.2, 1.9])
def test_a_small_step_to_nothing_is_a_fault_at_once(pressing):
    before = carried(30, pressing)
    faults = judge([*before, *carried(10, 0.0)])
    assert faults[30 + 5] is SensorFault.JUMPED
    assert set(judge([*before, *carried(10, pressing - 0.45)])) == {SensorFault.NONE}
