import math

import numpy as np
import pytest

from sonoservo.systems.control import GuardParameters
from sonoservo.systems.control.guard_decision import EMPTY, next_memory, retreat_speed
from sonoservo.systems.control.guard_parameters import (
    BODY_SPEED,
    CURVATURE,
    LONGEST,
    PEAK,
    REACTION,
    time_above,
)
from sonoservo.systems.control.guard_rules import CAUSES, RULES, Reaction, beyond, reason, remark
from sonoservo.systems.control.guard_sight import Mode, Sight, region

LIMITS = GuardParameters()
DOWN = (0.0, 0.0, -1.0)
REGION = region(LIMITS, [0.5, 0.0, 0.2], DOWN, alone=False)
STEP = 0.01
PLACE = (0.5, 0.0, 0.2)


def tilted(angle_deg):
    angle = math.radians(angle_deg)
    return (math.sin(angle), 0.0, -math.cos(angle))


def look(number, wrist=0.0, arm=0.0, **changes):
    """What a guard sees of a probe at rest: the wrist's noise is 0.02 N, the arm's 0.5 N."""
    noise = np.random.default_rng(number).standard_normal(7)
    wrist += 0.02 * noise[4]
    sample = (*(0.001 * noise[:3]).tolist(), 0.02 * noise[3], float(wrist), 4.9)
    seen = Sight(
        time=number * STEP, step=STEP, p=PLACE, axis=DOWN,
        p_measured=(PLACE[0] + 1e-9 * noise[5], *PLACE[1:]), p_ahead=None, axis_ahead=None,
        accepted=True, sample=sample, plausible=True, force=abs(wrist), wrist=wrist,
        arm=arm + 0.5 * noise[6], arm_then=arm + 0.5 * noise[6], arm_error=0.5, torque=noise[6],
    )  # fmt: skip
    return seen._replace(**changes)


def judged(sights, limits=LIMITS):
    memory, causes = EMPTY, []
    for seen in sights:
        memory = next_memory(memory, seen, limits, REGION, 0.5)
        causes.append(RULES[int(memory.cause)].name if memory.cause >= 0 else "")
    return memory, causes


BROKEN = {
    "wrist_not_finite": {"sample": 6 * (math.nan,), "plausible": False},
    "wrist_out_of_range": {"sample": (0.0, 0.0, 0.0, 0.0, 70.0, 0.0), "plausible": False},
    "wrist_frozen": {"sample": (0.0, 0.0, 0.0, 0.0, 2.0, 4.9)},
    "arm_not_finite": {"arm": math.nan},
    "arm_frozen": {"torque": 0.3},
    "disagree": {"arm_then": 5.0},
    "late": {"latency": 0.2},
    "force": {"force": 12.0},
    "depth": {"p_ahead": (0.5, 0.0, 0.179), "axis_ahead": DOWN},
    "pose_not_finite": {"p_measured": (math.nan, 0.0, 0.0)},
    "pose_error": {"p_measured": (0.5, 0.011, 0.2)},
    "command": {"accepted": False},
    "workspace": {"p_ahead": (0.76, 0.0, 0.2), "axis_ahead": DOWN},
    "tilt": {"p_ahead": PLACE, "axis_ahead": tilted(31)},
}


def test_nothing_happens_to_a_calm_contact_even_if_zeros_differ():
    memory, causes = judged(look(number, 2.5, 2.0) for number in range(8000))
    assert set(causes) == {""}
    assert remark(memory.noticed) == ""
    numbers = memory.pack()
    assert memory.unpack(numbers) == memory


@pytest.mark.parametrize("name", BROKEN)
def test_a_cause_is_found_after_its_time_and_a_shorter_one_is_noticed(name):
    rule = RULES[CAUSES[name]]
    time = LIMITS.wrist_sensor.confirmed_after if rule.time is None else rule.time
    if name.endswith("frozen"):  # from the sample that is repeated
        time = LIMITS.wrist_sensor.frozen_after + STEP
    long = max(math.ceil(time / STEP - 1e-9), 1)
    frozen = name.endswith("frozen")
    for steps, found in ((long, True), (long - 1 - frozen, False)):
        sights = [look(number, 2.0, 2.0) for number in range(100)]
        for number in range(50, 50 + steps + frozen):
            sights[number] = sights[number]._replace(**BROKEN[name])
        memory, causes = judged(sights)
        assert (name in causes) == found
        assert memory.interventions == found
        if not found and steps and name not in ("disagree", "wrist_frozen", "arm_frozen"):
            assert f"too short for a stop ({name.replace('_', ' ')}): {steps}" in remark(
                memory.noticed
            )
    for touches in (True, False):  # it reacts as its row says
        sights = [look(n, 2.0 * touches, 2.0 * touches) for n in range(68)]
        memory, _ = judged([*sights[:60], *(each._replace(**BROKEN[name]) for each in sights[60:])])
        away = touches or rule.reaction >= Reaction.AWAY
        assert memory.mode == (Mode.RETREATING if away else Mode.HOLDING)
        assert memory.doubts == (rule.reaction is Reaction.PROVE)


def test_a_sensor_that_is_wrong_in_every_other_sample_is_found():
    sights = [look(number, 2.0, 2.0) for number in range(60)]
    broken = BROKEN["wrist_not_finite"]
    sights += [look(60 + n, 2.0, 2.0, **(broken if n % 2 else {})) for n in range(20)]
    assert "wrist_not_finite" in judged(sights)[1]


@pytest.mark.parametrize(("difference", "within"), [(2.0, 0.2), (3.0, 0.06), (6.0, 0.03)])
def test_a_greater_disagreement_is_found_earlier(difference, within):
    times = []
    for start in range(0, 9000, 1000):
        wrist = 2.0 + difference * (np.arange(150) >= 50)
        sights = (look(start + n, each, 2.0, time=n * STEP) for n, each in enumerate(wrist))
        times.append((judged(sights)[1].index("disagree") - 49) * STEP)
    assert np.median(times) <= within


@pytest.mark.parametrize(
    ("p", "axis", "out"),
    [
        ((0.5, 0.0, 0.181), DOWN, False),
        ((0.5, 0.0, 0.179), DOWN, True),
        ((0.76, 0.0, 0.2), DOWN, True),
        ((0.5, 0.0, 0.33), DOWN, True),
        ((0.5, 0.0, 0.2), tilted(29), False),
        ((0.5, 0.0, 0.2), tilted(-31), True),
    ],
)
def test_workspace_depth_and_tilt(p, axis, out):
    assert (max(beyond(p, axis, EMPTY, REGION)) > 0) == out
    anywhere = region(LIMITS, [], DOWN, alone=False)
    assert (max(beyond(p, axis, EMPTY, anywhere)) > 0) == (axis == tilted(-31))


def test_depth_counts_from_where_contact_began_and_is_halved_without_a_second_witness():
    deep = EMPTY._replace(touched=1.0, depth=0.015, p=PLACE)
    for further, out in ((0.004, False), (0.006, True)):
        assert (beyond((0.5, 0.0, 0.2 - further), DOWN, deep, REGION)[0] > 0) == out
    alone = region(LIMITS, PLACE, DOWN, alone=True)
    assert beyond(PLACE, DOWN, deep, alone)[0] > 0
    assert beyond((0.5, 0.0, 0.189), DOWN, EMPTY, alone)[0] > 0


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
    assert travelled == pytest.approx(wanted, abs=3e-3)


def test_every_cause_has_a_reason_of_its_own():
    memory = EMPTY._replace(wrist_then=12.34, arm_then=2.0)
    reasons = {
        reason(memory._replace(cause=cause), LIMITS, REGION, alone=False)
        for cause in range(-1, len(RULES))
    }
    assert len(reasons) == len(RULES) + 1
    assert any("contact force exceeds 10 N" in each and "12.3 N" in each for each in reasons)
    held = memory._replace(cause=CAUSES["force"], mode=Mode.HOLDING, blocked=True, doubts=3)
    assert "because a retreat would leave" in reason(held, LIMITS, REGION, alone=False)
    assert "a person must confirm" in reason(held, LIMITS, REGION, alone=False)
    late = memory._replace(cause=CAUSES["late"])
    assert "by more than 0.05 s" in reason(late, LIMITS, REGION, alone=True)


def test_the_time_above_15_n_is_that_of_a_simulated_retreat():
    for force, speed, acceleration in ((10.0, 0.3, 10.0), (12.0, 0.15, 5.0), (9.0, 0.12, 20.0)):
        depth, time, above = math.sqrt(force / CURVATURE), 0.0, 0.0
        while depth > 0:
            away = min(max(time - REACTION, 0.0) * acceleration, speed)
            depth += (BODY_SPEED - away) * 1e-5
            above += 1e-5 * (CURVATURE * depth**2 > PEAK)
            time += 1e-5
        assert time_above(force, speed, acceleration) == pytest.approx(above, abs=2e-4)
    assert time_above(5.0, 0.3, 20.0) == 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"max_force": 14.0}, "would press with more than 15 N for .* ms, more than 50 ms"),
        ({"retreat_acceleration": 2.0}, "at 2 m/s.2: a body that rises at 0.1 m/s would press"),
        ({"workspace_min": [0, 0, 0], "workspace_max": [1, 1, 0]}, "workspace_min: .* below"),
    ],
)
def test_limits_that_do_not_keep_the_force_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        GuardParameters(**changes)
    assert time_above(10.0, LIMITS.retreat_speed, LIMITS.retreat_acceleration) < LONGEST
