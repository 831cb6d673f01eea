import numpy as np
import pytest

from sonoservo.systems.signals.confidence import RADIUS_95, SQUARED_DISTANCE_95


def test_95_percent_of_a_normal_distribution_in_a_plane_lie_within():
    # The radius has a Rayleigh distribution: P(r > R) = exp(-R^2 / 2).
    outside = np.exp(-0.5 * SQUARED_DISTANCE_95)
    assert outside == pytest.approx(0.05)
    assert pytest.approx(RADIUS_95, abs=1e-4) == 2.4477
