"""The published filter and its control input."""

import numpy as np
import pytest

from sonoservo.diagrams.papers.zhao2012.published_tracking import with_input
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter


def test_a_commanded_change_of_speed_moves_the_prediction():
    curve = NeedleCurve([[0, 0, 0], [0.01, 0, 0]])
    needle_filter = AxisTipFilter()
    state = needle_filter.start(NeedleMeasurement(curve, 1e-6 * np.eye(6), 0.0, 0, 0.0))
    without = needle_filter.predict(state, 1.0)
    moved = with_input(without, 2e-3, 1.0)
    np.testing.assert_allclose(moved.tip, without.tip + np.array([2e-3, 0, 0]))
    np.testing.assert_allclose(moved.tip_velocity, [2e-3, 0, 0])
    np.testing.assert_allclose(moved.curve.entry, without.curve.entry, atol=1e-12)
    assert moved.length == pytest.approx(without.length + 2e-3)
