import math

import numpy as np
import pytest

from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.control.guard_rules import (
    NO_BREACH,
    Breach,
    Cause,
    contact_force,
    leaving,
    moving_too_fast,
    outside,
    reason,
    region,
    remark,
    retreat_speed,
)
from sonoservo.systems.control.joint_limits import keeps_limits
from sonoservo.systems.control.wrist_sensor_check import SensorFault

LIMITS = GuardParameters()
DOWN = (0.0, 0.0, -1.0)
REGION = region(LIMITS, [0.5, 0.0, 0.2], DOWN)
STEP = 0.005


def tilted(angle_deg):
    angle = math.radians(angle_deg)
    return (math.sin(angle), 0.0, -math.cos(angle))


@pytest.mark.parametrize(
    ("p", "axis", "cause"),
    [
        ((0.5, 0.0, 0.2), DOWN, Cause.NONE),
        ((0.5, 0.0, 0.181), DOWN, Cause.NONE),
        ((0.5, 0.0, 0.179), DOWN, Cause.DEPTH),
        ((0.76, 0.0, 0.2), DOWN, Cause.WORKSPACE),
        ((0.5, 0.0, 0.33), DOWN, Cause.WORKSPACE),
        ((0.5, 0.0, 0.2), tilted(29), Cause.NONE),
        ((0.5, 0.0, 0.2), tilted(-31), Cause.TILT),
    ],
)
def test_workspace_depth_and_tilt(p, axis, cause):
    assert outside(p, axis, REGION).cause is cause


def test_without_a_surface_only_the_tilt_counts():
    anywhere = region(LIMITS, [], DOWN)
    assert outside((9.0, 9.0, -9.0), DOWN, anywhere) is NO_BREACH
    assert outside((0.0, 0.0, 0.0), tilted(40), anywhere).cause is Cause.TILT


def test_the_way_back_into_the_region_is_free():
    now, nearer, farther = (Breach(Cause.DEPTH, each) for each in (0.01, 0.009, 0.011))
    assert leaving(now, nearer) is NO_BREACH
    assert leaving(now, NO_BREACH) is NO_BREACH
    assert leaving(now, farther) is farther
    assert leaving(now, now) is now
    assert leaving(NO_BREACH, nearer) is nearer


def test_speed_and_acceleration_of_the_probe():
    slow = (0.1 * STEP, 0.0, 0.0)
    assert moving_too_fast(slow, (0.1, 0.0, 0.0), STEP, LIMITS) is NO_BREACH
    assert moving_too_fast(slow, (-0.1, 0.0, 0.0), STEP, LIMITS).cause is Cause.ACCELERATION
    assert moving_too_fast((0.0, 0.2 * STEP, 0.0), (0.0, 0.2, 0.0), STEP, LIMITS).cause is (
        Cause.SPEED
    )
    # Before the first step, no velocity is known.
    assert moving_too_fast(slow, 3 * (math.nan,), STEP, LIMITS) is NO_BREACH


def test_contact_force_is_free_of_the_weight():
    assert contact_force((1.0, 2.0 - 4.9, 0.0), (0.0, 1.0, 0.0), 4.9) == pytest.approx((-1, -2, 0))


@pytest.mark.parametrize("free", [True, False])
def test_a_retreat_keeps_its_limits_and_ends(free):
    speed, travelled, speeds = 0.0, 0.0, []
    while not speeds or speed > 0:
        speed = retreat_speed(speed, travelled, free, STEP, LIMITS)
        travelled += STEP * speed
        speeds.append(speed)
    assert max(speeds) <= LIMITS.retreat_speed
    assert np.abs(np.diff(speeds)).max() <= LIMITS.retreat_acceleration * STEP + 1e-12
    wanted = LIMITS.clearance if free else LIMITS.max_retreat
    assert travelled == pytest.approx(wanted, abs=2e-3)


def test_commands_that_jump_or_leave_the_limits_or_are_no_numbers():
    limits = np.stack([-np.ones(4), np.ones(4), np.full(4, 0.1)])
    last = np.zeros(6)
    assert keeps_limits(np.full(4, 0.05), last, limits)
    for bad in (0.2, 2.0, np.nan):
        wanted = np.array([0.0, 0.0, 0.0, bad])
        assert not keeps_limits(wanted, last, limits)
    unknown = np.full(6, np.nan)
    assert keeps_limits(np.full(4, 0.9), unknown, limits)
    assert not keeps_limits(np.full(4, 1.1), unknown, limits)


def test_every_cause_has_a_reason_of_its_own():
    reasons = {reason(cause, 12.34, LIMITS) for cause in Cause}
    assert len(reasons) == len(Cause)
    assert reason(Cause.FORCE, 12.34, LIMITS) == "the contact force of 12.3 N exceeded 10 N"
    assert reason(float(Cause.NONE), math.nan, LIMITS) == ""


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"max_force": 50.0}, "max_force: 50.0 is not allowed; it must be above 0 and at most 20"),
        ({"surface": [0.1]}, "surface: "),
        ({"workspace_min": [0, 0, 0], "workspace_max": [1, 1, 0]}, "workspace_min: .* below"),
        ({"max_tilt_deg": 100.0}, "max_tilt_deg: 100.0"),
        ({"clearance": 0.0}, "clearance: 0.0"),
    ],
)
def test_limits_that_are_not_allowed(changes, message):
    with pytest.raises(ValueError, match=message):
        GuardParameters(**changes)


def test_a_remark_names_all_that_was_noticed():
    assert remark(0, SensorFault.NONE) == ""
    assert remark(3, SensorFault.FROZEN) == (
        "samples of the wrist sensor that were ignored: 3, the last because it was frozen"
    )
    assert remark(0, SensorFault.NONE, 1, 2.0, 3.0) == (
        "steps of the force by more than 0.5 N between samples: 1; "
        "samples of the wrist sensor that repeated the one before: 2; "
        "measured poses that repeated the one before: 3"
    )
