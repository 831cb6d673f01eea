"""Stick-slip of the tissue at a needle, against the closed form."""

import numpy as np
import pytest

from sonoservo.systems.ultrasound.simulation.reaction.tissue_reaction import (
    Drag,
    NeedleDragParameters,
    advance_drag,
)

STICKY = NeedleDragParameters(distance=1e-3, kept=0.6, slip_time=0.1, relaxation_time=1e6)


def driven(speed, times, parameters, start=None):
    """Drag at rising times from 0 of a needle at constant speed."""
    drag, now, found = start or Drag(), 0.0, []
    for time in times:
        drag = advance_drag(drag, speed * (time - now), time - now, parameters)
        now = time
        found.append(drag.distance)
    return np.array(found)


def test_tissue_sticks_slides_back_and_sticks_again():
    speed, times = 5e-3, np.arange(0.001, 2, 0.001)
    found = driven(speed, times, STICKY)
    # 0.2 s to the limit; then 0.1 s down to 60 % of it and 0.08 s up again.
    phase = np.mod(times - 0.2, 0.18)
    sawtooth = np.where(phase < 0.1, 1e-3 - 4e-3 * phase, 0.6e-3 + speed * (phase - 0.1))
    np.testing.assert_allclose(found, np.where(times < 0.2, speed * times, sawtooth), atol=1e-9)


def test_result_does_not_depend_on_the_steps():
    parameters = NeedleDragParameters(distance=1e-3)
    coarse = np.array([0.7, 1.9, 3.3])
    fine = driven(8e-3, np.arange(1, 331) / 100, parameters)
    np.testing.assert_allclose(driven(8e-3, coarse, parameters), fine[[69, 189, 329]], atol=1e-12)


def test_tissue_relaxes_after_a_stop():
    parameters = NeedleDragParameters(distance=1e-3, relaxation_time=2.0)
    start = Drag(0.8e-3)
    np.testing.assert_allclose(
        driven(0.0, [1.0, 2.0, 8.0], parameters, start),
        0.8e-3 * np.exp([-0.5, -1.0, -4.0]),
        rtol=1e-12,
    )


def test_slow_needle_never_slips_and_a_withdrawn_one_drags_backwards():
    parameters = NeedleDragParameters(distance=1e-3, relaxation_time=2.0)
    assert driven(0.4e-3, [60.0], parameters)[0] == pytest.approx(0.8e-3)
    there = driven(5e-3, np.arange(1, 50) / 30, parameters)
    back = driven(-5e-3, np.arange(1, 50) / 30, parameters)
    np.testing.assert_allclose(back, -there)
    assert there.max() <= 1e-3
    assert there.max() > 0.95e-3
