import dataclasses

import numpy as np
import pytest
from synthetic_volumes import Scene, entry_on_side

from sonoservo.systems.tracking import EdgeVelocimeterParameters
from sonoservo.systems.tracking.edge_velocimeter import measure_edge_velocity

SCENE = Scene(seed=5, spacing=1.0e-3)
ENTRY = entry_on_side()
K = np.array([1, 0.25, 0.1]) / np.linalg.norm([1, 0.25, 0.1])
PERIOD = 0.303


def volume(number, speed):
    def needle(time):
        return ENTRY, ENTRY + (0.02 + speed * time) * K

    return SCENE.volume(number, needle)


def measure(speed, guessed, **changes):
    before, predicted = (ENTRY + (0.02 + guessed * n * PERIOD) * K for n in (0, 2))
    parameters = dataclasses.replace(EdgeVelocimeterParameters(), **changes)
    return measure_edge_velocity(
        volume(2, speed), volume(0, speed), before, predicted, K, parameters
    )


@pytest.mark.parametrize("speed", [0.0, 8e-3])
def test_the_end_moves_as_fast_as_the_needle_whatever_was_predicted(speed):
    found = measure(speed, 4e-3)
    # The synthetic highlight moves along the needle, which a real one does not.
    assert found.velocity @ K == pytest.approx(speed, abs=2e-3)
    np.testing.assert_allclose(found.velocity, (found.velocity @ K) * K)


def test_its_uncertainty_is_small_along_the_needle_only():
    covariance = measure(5e-3, 5e-3).covariance
    assert 0.5e-3 < np.sqrt(K @ covariance @ K) < 3.5e-3
    assert np.linalg.eigvalsh(covariance)[-1] == pytest.approx(20e-3**2)


def test_nothing_to_follow():
    empty = Scene(seed=5, spacing=1e-3)
    tip = ENTRY + 0.02 * K
    found = measure_edge_velocity(
        empty.volume(2), empty.volume(0), tip, tip, K, EdgeVelocimeterParameters()
    )
    assert not found or np.linalg.norm(found.velocity) < 0.05
    still = volume(0, 0.0)
    again = measure_edge_velocity(still, still, tip, tip, K, EdgeVelocimeterParameters())
    assert again.reason == "the volumes were acquired at the same time"
