import math

import numpy as np
import pytest

from sonoservo.systems.control.force_latency import lags, next_correlation

STEP = 0.01


def measured_latency(lag, *, contact=0.0, seed=0, pulse=0.5):
    """Latency by the pulses of a probe that is started and stopped, once a second."""
    rng = np.random.default_rng(seed)
    inertia = np.zeros(400)
    inertia[100::200], inertia[200::200] = pulse, -pulse
    felt = np.roll(inertia, lag) + 0.02 * rng.standard_normal(400)
    felt += contact * np.cumsum(rng.standard_normal(400))
    state, last = np.zeros((4, lags(STEP))), math.nan
    for before, now, expected, expected_before in zip(
        felt, felt[1:], inertia[1:], inertia, strict=False
    ):
        state, found = next_correlation(state, expected - expected_before, now - before, STEP)
        last = found if found == found else last
    return last


@pytest.mark.parametrize("lag", [0, 5, 30])
def test_a_latency_is_found_to_the_step(lag):
    assert measured_latency(lag) == pytest.approx(lag * STEP, abs=1e-9)


def test_beside_a_contact_that_changes_nothing_is_found():
    assert math.isnan(measured_latency(5, contact=0.5))
    assert math.isnan(measured_latency(5, pulse=0.0))
