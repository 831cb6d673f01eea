import numpy as np
import pytest
from synthetic_volumes import GEOMETRY

from sonoservo.systems.evaluation.run_errors import curve_deviations, deviation
from sonoservo.systems.signals.needle_curve import NeedleCurve

DEPTH = 0.05


def line(start, stop, y=DEPTH, order=9):
    """Points along X, in P."""
    x = np.linspace(start, stop, order)
    return np.stack([x, np.full(order, y), np.zeros(order)], axis=1)


def arc(radius, length, count=9):
    s = np.linspace(0, length, count) / radius
    return np.stack([radius * np.sin(s) - 0.03, DEPTH - radius * (1 - np.cos(s)), 0 * s], axis=1)


@pytest.mark.parametrize("tip", [0.015, 0.02, 0.022])
def test_at_the_tip_it_is_the_tip_s_error(tip):
    estimate = NeedleCurve(line(-0.02, tip, order=2))
    assert deviation(line(-0.02, 0.02), estimate, GEOMETRY) == pytest.approx(abs(tip - 0.02))


def test_what_is_before_the_estimated_entry_or_outside_the_image_does_not_count():
    estimate = NeedleCurve(line(-0.02, 0.02, order=2))
    assert deviation(line(-0.2, 0.02), estimate, GEOMETRY) < 0.3e-3
    bent = line(-0.2, 0.02, order=201)
    bent[:120, 1] += 0.05 * (1 - np.arange(120) / 120)
    outside = NeedleCurve(line(-0.5, 0.02, order=2))
    assert not GEOMETRY.contains(bent[:120]).any()
    assert deviation(bent, outside, GEOMETRY) < 0.3e-3
    assert np.isnan(deviation(line(-0.9, -0.8), estimate, GEOMETRY))


def test_a_chord_misses_an_arc_by_its_sagitta():
    radius, length = 0.15, 0.06
    ends = NeedleCurve(arc(radius, length)[[0, -1]])
    sagitta = radius * (1 - np.cos(length / radius / 2))
    assert deviation(arc(radius, length), ends, GEOMETRY) == pytest.approx(sagitta, rel=0.02)
    parabola = NeedleCurve(arc(radius, length, 3))
    assert deviation(arc(radius, length), parabola, GEOMETRY) < 0.05 * sagitta


def test_of_a_log_in_the_probe_s_frame_at_the_estimate_s_time(make_log):
    """The needle sinks at 1 cm/s and the probe with it; the estimate is late but dated."""
    time = np.arange(0, 1, 1 / 32)
    X_WP = np.tile(np.eye(4), (len(time), 1, 1))
    X_WP[:, 1, 3] = 1e-2 * time
    sinking = np.stack([0 * time, 1e-2 * time, 0 * time], axis=1)[:, np.newaxis]
    estimates = np.stack(
        [line(-0.02, 0.02, order=3) + np.array([0, 1e-2 * t, 0]) for t in (0.3, 0.6, 0.8)]
    )
    estimates[1, :, 1] += 0.5e-3
    estimates[2] = np.nan
    log = make_log(
        len(time),
        3,
        time=time,
        X_WP=X_WP,
        needle_points=line(-0.02, 0.02) + sinking,
        volume_estimate_time=np.array([0.3, 0.6, 0.8]),
        volume_estimate_points=estimates,
    )
    np.testing.assert_allclose(curve_deviations(log, GEOMETRY), [0, 0.5e-3, np.nan], atol=1e-6)
