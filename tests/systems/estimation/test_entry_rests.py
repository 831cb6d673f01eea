"""A volume says nothing of where along the axis the entry is: it must not slide towards the tip."""

import numpy as np

from sonoservo.systems.estimation.needle_kalman_filter import (
    NeedleKalmanFilterParameters,
    restart_track,
    update_track,
)
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement


def test_entry_rests_along_an_axis_that_does_not_show_it():
    parameters = NeedleKalmanFilterParameters()
    covariance = np.diag([1e-6, 1e-8, 1e-8, 0.36e-6, 1e-8, 1e-8])

    def measurement(entry, tip, time):
        curve = NeedleCurve([[entry, 0, 0], [tip, 0, 0]])
        return NeedleMeasurement(curve, covariance, time, 200, 0.8)

    track = restart_track(measurement(0.0, 0.02, 0.0), parameters)
    for k in range(1, 100):
        tip = 0.02 + min(0.3 * k * 5e-3, 0.04)
        predicted = track.predicted(0.3 * k)
        # As the localizer does: where the entry was last, projected on the axis.
        track = update_track(predicted, measurement(track.curve.entry[0], tip, 0.3 * k))
    assert track.mode == TrackingMode.TRACKING
    assert abs(track.curve.entry[0]) < 1e-3
