import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform

from sonoservo.systems.display.console.readings import (
    Cine,
    Frame,
    Sample,
    Strips,
    describe_state,
    sample_estimate,
    tip_error,
)
from sonoservo.systems.signals import NeedleCurve, NeedleEstimate, TrackingMode

X_WP = RigidTransform([0.4, 0.1, 0.3])


def estimate(tip=(0.01, 0.05, 0.01), time=1.0, mode=TrackingMode.TRACKING):
    curve = NeedleCurve([[-0.03, 0.03, -0.02], tip]).transformed(X_WP)
    return NeedleEstimate(mode, time, curve, np.zeros((2, 3)), np.eye(12), time)


def searching(reason, volume_time=1.0):
    return NeedleEstimate(TrackingMode.SEARCHING, 1.0, volume_time=volume_time, reason=reason)


def test_the_features_are_those_that_the_servo_drives_to_zero():
    sample = sample_estimate(1.2, estimate(), X_WP, force=2.0)
    assert (sample.mode, sample.force) == ("tracking", 2.0)
    assert sample.x == pytest.approx(10)
    assert sample.z == pytest.approx(10)
    assert sample.theta == pytest.approx(36.87, abs=0.01)  # 3 across, 4 along
    assert sample.depth == pytest.approx(50)
    assert math.isnan(sample.error)


def test_the_error_is_that_at_the_time_of_the_estimate():
    tips = [(0.5, X_WP.multiply([0.0, 0.05, 0.01])), (1.5, X_WP.multiply([0.02, 0.05, 0.01]))]
    assert tip_error(estimate(time=1.0), tips) == pytest.approx(0, abs=1e-9)
    assert tip_error(estimate(time=0.75), tips) == pytest.approx(5)
    for unknown in (tip_error(estimate(time=0.4), tips), tip_error(estimate(), []),
                    tip_error(searching(""), tips)):  # fmt: skip
        assert math.isnan(unknown)


def state(**values):
    return describe_state(Sample(time=1.0, **values))


def test_the_state_is_said_in_words():
    assert describe_state(None)["word"] == "waiting"
    assert state(mode="tracking") == {
        "kind": "tracking", "word": "tracking", "detail": "", "advice": "",
    }  # fmt: skip
    assert state(mode="lost", reason="none of 3 candidates")["detail"] == "none of 3 candidates"
    stopped = state(mode="tracking", stopped="the force is above 6 N")
    assert (stopped["kind"], stopped["detail"]) == ("stopped", "the force is above 6 N")
    assert state(reason="following")["word"] == "following"
    early = sample_estimate(0.0, searching("", -math.inf), X_WP)
    assert describe_state(early)["detail"].startswith("waiting for the first volume")
    sample = sample_estimate(1.0, searching("nothing changed by more than 3.0 dB"), X_WP)
    assert describe_state(sample)["detail"] == "nothing changes"
    assert describe_state(sample)["advice"].endswith("whole volumes (--start anywhere)")
    assert describe_state(replace(sample, inserted=0.0))["advice"] == ""
    inside = replace(sample, inserted=12.0)
    assert describe_state(inside)["advice"] == ""
    told = describe_state(inside, operated=True)
    assert told["advice"].startswith("push the needle in while the probe looks on, or make it")


def test_strips_keep_a_minute_and_let_pages_catch_up():
    strips = Strips()
    assert strips.newest is None
    for k in range(700):
        strips.append(Sample(time=k / 8, x=float(k)))
    assert strips.newest.x == 699
    columns = strips.columns(695)
    assert columns["x"] == [695, 696, 697, 698, 699]
    assert strips.columns(strips.begin)["time"][0] == pytest.approx(699 / 8 - 60)
    end = strips.end
    strips.append(Sample(time=0.0, x=-1.0))  # a new run
    assert strips.begin > end  # no page that has shown the old samples goes on from there
    assert strips.columns(strips.begin)["x"] == [-1.0]


def test_the_cine_keeps_a_minute_and_finds_the_nearest_frame():
    cine = Cine()
    assert cine.at(3.0) is None
    for k in range(250):
        cine.append(Frame(k, 0.3 * k, "tracking", [], 0.25))
    assert len(cine) in (200, 201)
    assert cine.at(40.05).number == 133
    assert cine.at(-5).number in (49, 50)
    cine.append(Frame(1, 0.3, "", [], 0.25))
    assert cine.times == [0.3]
