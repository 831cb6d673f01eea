import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.recording.metrics import (
    MetricsParameters,
    estimate_errors,
    features,
    needle_speed,
    summarize,
)

coordinate = st.floats(-0.2, 0.2)
point = st.tuples(coordinate, coordinate, coordinate)
angle = st.floats(-3, 3)


def test_the_whole_summary_is_json(insertion_log, make_log):
    for log in (insertion_log, make_log(0, 0), make_log(5, 3), make_log(1, 0, time=np.zeros(1))):
        json.dumps(summarize(log), allow_nan=False)


def test_a_log_without_anything_has_no_figures(make_log):
    summary = summarize(make_log(4, 2, time=np.arange(4.0)))
    assert summary["detection"] == {
        "volume": None,
        "inserted_mm": None,
        "visible_mm": None,
        "false_starts": 0,
    }
    assert summary["tracking"]["volumes"] == 0
    assert summary["tracking"]["tip_error_mm"] == {"median": None, "p95": None, "max": None}
    assert summary["servo"]["at_rest"]["x_mm"] is None
    assert summary["force"]["mean_n"] is None


def test_detection(insertion_log):
    summary = summarize(insertion_log)
    first = int(np.argmax(insertion_log.volume_time >= 4))
    expected = 5 * (insertion_log.volume_time[first] - 2)
    assert summary["detection"]["volume"] == first
    assert summary["detection"]["inserted_mm"] == pytest.approx(expected)
    assert summary["detection"]["false_starts"] == 0


@pytest.mark.parametrize("volume", [2, 9])  # before the needle is there, and while it is
def test_a_start_away_from_the_needle_is_false(insertion_log, volume):
    tip, entry = (
        insertion_log.volume_estimate_tip.copy(),
        insertion_log.volume_estimate_entry.copy(),
    )
    tip[volume], entry[volume] = [0.0, 0.02, -0.04], [0.0, 0.04, -0.04]
    log = replace(insertion_log, volume_estimate_tip=tip, volume_estimate_entry=entry)
    detection = summarize(log)["detection"]
    assert detection["false_starts"] == 1
    assert detection["volume"] == summarize(insertion_log)["detection"]["volume"]
    assert summarize(log)["tracking"] == summarize(insertion_log)["tracking"]


def test_tracking_errors(insertion_log):
    tracking = summarize(insertion_log)["tracking"]
    found = int(np.sum(np.isfinite(insertion_log.volume_estimate_tip[:, 0])))
    assert tracking["volumes"] == tracking["tracked"] == tracking["estimated"] == found
    assert tracking["lost"] == tracking["lost_events"] == 0
    for statistic in ("median", "p95", "max"):
        assert tracking["tip_error_mm"][statistic] == pytest.approx(0.5)
        assert tracking["tip_axial_error_mm"][statistic] == pytest.approx(0.3)
        assert tracking["tip_lateral_error_mm"][statistic] == pytest.approx(0.4)
        assert tracking["axis_error_deg"][statistic] == pytest.approx(0, abs=1e-6)
    assert tracking["tip_axial_bias_mm"] == pytest.approx(0.3)


def test_a_reversed_needle_is_half_a_turn_wrong(insertion_log):
    log = replace(
        insertion_log,
        volume_estimate_tip=insertion_log.volume_estimate_entry,
        volume_estimate_entry=insertion_log.volume_estimate_tip,
    )
    assert np.nanmin(estimate_errors(log).axis) == pytest.approx(np.pi)


def test_failures_stay_in_the_statistics(insertion_log):
    first = summarize(insertion_log)["detection"]["volume"]
    mode = insertion_log.volume_estimate_mode.copy()
    tip = insertion_log.volume_estimate_tip.copy()
    entry = insertion_log.volume_estimate_entry.copy()
    mode[first + 1] = "coasting"  # with less than 15 mm inside: not lost
    mode[first + 10 : first + 13] = "coasting", "lost", "lost"
    tip[first + 11] += [0, 0.1, 0]  # a wrong estimate counts
    mode[first + 20] = "searching"  # none at all counts as lost
    tip[first + 20] = entry[first + 20] = np.nan
    log = replace(
        insertion_log,
        volume_estimate_mode=mode,
        volume_estimate_tip=tip,
        volume_estimate_entry=entry,
    )
    tracking, before = summarize(log)["tracking"], summarize(insertion_log)["tracking"]
    assert tracking["volumes"] == before["volumes"]
    assert tracking["tracked"] == before["tracked"] - 5
    assert tracking["estimated"] == before["estimated"] - 1
    assert tracking["lost"] == 4
    assert tracking["lost_events"] == 2
    assert tracking["tip_error_mm"]["max"] == pytest.approx(np.hypot(100, 0.5))


def test_truth_is_taken_at_the_time_of_the_estimate(insertion_log):
    # Estimates that hold 0.1 s later and say where the tip then is are right.
    later = insertion_log.volume_estimate_time + 0.1
    length = np.clip(5e-3 * (later - 2), 0, 50e-3)
    tip = insertion_log.volume_estimate_entry + length[:, np.newaxis] * [1, 0, 0]
    log = replace(insertion_log, volume_estimate_time=later, volume_estimate_tip=tip)
    assert summarize(log)["tracking"]["tip_error_mm"]["max"] == pytest.approx(0.5)


def test_servo(insertion_log):
    servo = summarize(insertion_log)["servo"]
    # The needle stops at 12 s at X = 0, 50 mm from its entry; 3 s of transient are left out.
    assert servo["at_rest"]["x_mm"] == pytest.approx(0, abs=1e-9)
    assert servo["at_rest"]["z_mm"] == pytest.approx(0, abs=1e-9)
    assert servo["at_rest"]["theta_deg"] == pytest.approx(0, abs=1e-9)
    assert servo["at_rest"]["seconds"] == pytest.approx(20 - 12 - 3, abs=0.5)
    assert servo["at_rest_estimated"]["x_mm"] == pytest.approx(0.3)
    # While it moves and is tracked, x runs from where it is found to 0; that it has stopped shows
    # up to half a window later.
    tracked = insertion_log.estimate_mode == "tracking"
    most, least = (
        1e3 * np.mean(50e-3 - insertion_log.inserted_length[tracked & (insertion_log.time < end)])
        for end in (12.0, 12.5)
    )
    assert least < servo["moving"]["x_mm"] < most


def test_a_needle_in_a_moving_phantom_is_not_at_rest(insertion_log):
    tip = insertion_log.needle_tip + 5e-3 * np.sin(insertion_log.time)[:, np.newaxis]
    assert summarize(replace(insertion_log, needle_tip=tip))["servo"]["at_rest"]["x_mm"] is None


def test_speed_without_tremor(insertion_log):
    time = insertion_log.time
    rng = np.random.default_rng(0)
    tremor = 0.05e-3 * np.sin(2 * np.pi * 9.3 * time + rng.uniform(0, 6, (3, 1))).T
    log = replace(insertion_log, needle_tip=insertion_log.needle_tip + tremor)
    speed = needle_speed(log, window=1.0)
    assert np.isnan(speed[time <= 2]).all()
    np.testing.assert_allclose(speed[(time > 2.7) & (time < 11.5)], 5e-3, atol=0.1e-3)
    assert (speed[time > 12.6] < 0.1e-3).all()


def test_force(insertion_log):
    force = summarize(insertion_log)["force"]
    assert force["contact_lost_s"] == pytest.approx(0.5)
    assert force["max_n"] == 2.0
    settled = 20 - 3  # from 2 s after the first contact at 1 s
    assert force["mean_n"] == pytest.approx(2 * (1 - 0.5 / settled))
    assert force["rms_error_n"] == pytest.approx(2 * np.sqrt(0.5 / settled))


def test_computing_time(insertion_log):
    assert summarize(insertion_log)["compute_ms"] == {"track": {"median": 5.0, "max": 9.0}}


@given(angle, angle, angle, point, point, st.floats(-1.5, 1.5), st.floats(-1.2, 1.2))
def test_features_do_not_depend_on_where_the_probe_is(roll, pitch, yaw, origin, tip, theta, dip):
    X_WP = RigidTransform(RollPitchYaw(roll, pitch, yaw), origin)
    k = np.array([np.cos(theta) * np.cos(dip), np.sin(dip), np.sin(theta) * np.cos(dip)])
    for sense in (1, -1):  # a direction and its opposite are one axis
        p_PEntry = np.array(tip) - 0.05 * sense * k
        result = features(
            X_WP.GetAsMatrix4()[np.newaxis],
            X_WP.multiply(np.array(tip))[np.newaxis],
            X_WP.multiply(p_PEntry)[np.newaxis],
        )
        np.testing.assert_allclose(result, [[tip[0], tip[2], theta]], atol=1e-9)


def test_parameters_are_checked():
    with pytest.raises(ValueError, match="rest_speed: 0 is not allowed"):
        MetricsParameters(rest_speed=0)
    with pytest.raises(ValueError, match="settling_time: -1 is not allowed"):
        MetricsParameters(settling_time=-1)
