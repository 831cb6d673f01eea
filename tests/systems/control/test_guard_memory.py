import math

import numpy as np

from sonoservo.systems.control.guard_memory import (
    GuardMemory,
    Observation,
    next_memory,
    unpack,
)
from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.guard_rules import Cause, Mode, region

STEP = 0.005
LIMITS = GuardParameters()
DOWN = (0.0, 0.0, -1.0)
REGION = region(LIMITS, [0.0, 0.0, 0.0], DOWN)


def observe(number, height, pressing):
    """What a guard sees of a probe at rest."""
    p, noise = (0.0, 0.0, height), 0.01 * (-1) ** number
    return Observation(
        time=number * STEP,
        p=p,
        axis=DOWN,
        p_measured=p,
        p_ahead=p,
        axis_ahead=DOWN,
        seconds_ahead=0.05,
        accepted=True,
        wrist_force=(0.0, 0.0, 0.0, 0.0, pressing + noise, 4.9),
        contact=(0.0, -pressing, 0.0),
    )


def memories(observations):
    memory = GuardMemory()
    for seen in observations:
        memory = next_memory(memory, seen, LIMITS, REGION, STEP)
        yield memory


def test_a_memory_is_numbers_and_comes_back_from_them():
    memory = list(memories(observe(number, 0.0, 2.0) for number in range(5)))[-1]
    numbers = memory.pack()
    np.testing.assert_array_equal(unpack(np.array(numbers).tolist()).pack(), numbers)
    np.testing.assert_array_equal(memory.quiet_force, [0.0, 2.01, 4.9])
    for changed in (
        memory._replace(over=1),
        memory._replace(sensor=memory.sensor._replace(fault=1)),
    ):
        assert np.isnan(changed.quiet_force).all()
    fresh = unpack(np.array(GuardMemory().pack()).tolist())
    assert fresh.mode == Mode.MONITORING
    assert math.isnan(fresh.p[0])
    assert not fresh.sensor.started


def test_a_force_felt_high_in_the_air_is_a_bias():
    for height, stops in ((0.05, False), (0.07, True)):
        last = list(memories(observe(number, height, 3.0) for number in range(20)))[-1]
        assert (last.mode != Mode.MONITORING) == stops
        assert (last.cause == Cause.SENSOR_IN_AIR) == stops


def test_held_at_the_edge_of_the_workspace_the_probe_does_not_retreat_further():
    *_, last = memories(observe(number, 0.125, 12.0) for number in range(40))
    assert last.mode == Mode.HOLDING
    assert last.interventions == 1


def test_it_goes_on_after_a_while_without_a_cause():
    memory, height, modes = GuardMemory(), 0.0, []
    for number, pressing in enumerate([5.0] * 10 + [12.0] * 5 + [5.0] * 5 + [0.0] * 200):
        height += STEP * memory.speed
        memory = next_memory(memory, observe(number, height, pressing), LIMITS, REGION, STEP)
        modes.append(memory.mode)
    assert modes[11] == Mode.RETREATING
    assert Mode.HOLDING in modes
    assert modes[-1] == Mode.MONITORING
    assert memory.interventions == 1
    assert 0.02 <= height < 0.05


def test_a_step_of_the_force_is_noted_unless_the_arm_or_a_fault_explains_it():
    def steps(suddenly=0.0, force=2.0):
        seen = [observe(number, 0.0, 2.0) for number in range(40)]
        for number in range(30, 40):
            p = (0.0, 0.0, -suddenly * (number - 29) * STEP)
            wrist_force = (*seen[number].wrist_force[:4], force, 4.9 + 0.01 * (-1) ** number)
            seen[number] = seen[number]._replace(
                p=p, p_measured=p, wrist_force=wrist_force, stepped=number == 30
            )
        return list(memories(seen))[-1].steps

    assert steps() == 1
    assert steps(suddenly=0.02) == 0  # the probe's inertia
    assert steps(force=100.0) == 0  # out of range
