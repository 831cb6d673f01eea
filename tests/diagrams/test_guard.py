"""Faults in the loop: what the guard must hold, with the true contact force as judge."""

import pytest
from fault_runs import (
    FaultCase,
    at_ceilings,
    ceiling_cases,
    fault_cases,
    fault_table,
    phantom_move,
    run_faults,
)

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.probe_controller import ProbeControllerParameters
from sonoservo.systems.control.guard_parameters import GuardParameters
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.robot.errors.sensor_faults import SensorFault

FASTEST = 0.1
"""Speed of the phantom in m/s up to which the force must stay in its limit."""


def speed(case):
    """Highest speed of a case's phantom, in m/s."""
    return 1.5 * abs(case.move.translation[2]) / case.move.duration if case.move else 0.0


def held(result):
    """Whether what must hold did."""
    if speed(result.case) > FASTEST + 1e-9:
        return result.above_after_stop <= 0.3
    return result.longest_above <= 0.05


def needs_reason(result):
    """Whether something was wrong, so that a reason or a remark must be there."""
    case = result.case
    return case.sensor or case.pose or not result.recovered or result.peak > 10.5


QUICK = {
    "bias before contact": (
        FaultCase(
            name="bias of -10 N before contact", phase="approach",
            sensor=SensorFault(kind="bias", value=-10), duration=1.0,
        ),
        "wrist sensor",
    ),
    "frozen before contact": (
        FaultCase(
            name="frozen before contact", phase="approach",
            sensor=SensorFault(kind="frozen"), duration=2.0,
        ),
        "the wrist sensor is frozen",
    ),
    "nan": (FaultCase(name="NaN", sensor=SensorFault(kind="nan"), duration=0.5), "not numbers"),
    "dead": (
        FaultCase(name="dead", sensor=SensorFault(kind="dead"), duration=0.4), "sensor jumped",
    ),
    "bias": (
        FaultCase(name="bias of -3 N", sensor=SensorFault(kind="bias", value=-3), duration=0.4),
        "sensor jumped",
    ),
    "frozen pose": (
        FaultCase(name="pose frozen", phase="approach", pose="frozen", duration=0.4, after=0.6),
        "the measured pose of the probe is frozen",
    ),
    "frozen pose at rest": (
        FaultCase(name="pose frozen at rest", pose="frozen", duration=0.4, after=0.3),
        "measured poses that repeated the one before: ",
    ),
    "repeated samples": (
        FaultCase(name="two", sensor=SensorFault(kind="frozen"), duration=0.02, after=0.1),
        "samples of the wrist sensor that repeated the one before: 2",
    ),
    "small bias": (
        FaultCase(
            name="bias of -0.7 N", sensor=SensorFault(kind="bias", value=-0.7), duration=0.01,
            after=0.1,
        ),
        "steps of the force by more than 0.5 N between samples: 2",
    ),
    "brief jump of the pose": (
        FaultCase(name="pose jumps", pose="jump", duration=0.01, after=0.4),
        "the probe is 30 mm from where it was commanded to be",
    ),
    "phantom": (
        FaultCase(name="phantom 50 mm up", move=phantom_move(0.05, FASTEST), duration=0),
        "contact force",
    ),
    "fast phantom": (
        FaultCase(name="phantom 20 mm up", move=phantom_move(0.02, 0.6), duration=0),
        "the wrist sensor jumped by more than 2 N",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def results():
    cases = [case for case, _ in QUICK.values()]
    return dict(zip(QUICK, run_faults(cases), strict=True))


@pytest.mark.parametrize("name", QUICK)
def test_a_fault_is_held_with_a_reason_and_work_goes_on_after_it(results, name):
    result = results[name]
    assert held(result), fault_table([result])
    assert any(QUICK[name][1] in each for each in result.reasons)
    assert result.recovered


def test_a_fault_close_to_the_wanted_force_leaves_no_wrong_one():
    """The force law does not wind up meanwhile."""
    strong = at_ceilings({"force": {"force": 4.5}})
    fault, rise = SensorFault(kind="frozen"), phantom_move(0.02, FASTEST)
    case = FaultCase(
        name="frozen", sensor=fault, duration=4.0, after=2.5, move=rise, controller=strong
    )
    (result,) = run_faults([case])
    assert result.recovered
    assert result.force_at_end == pytest.approx(4.5, abs=0.2)


def test_a_sensor_that_dies_while_it_bears_nothing_is_noticed():
    strong = at_ceilings({"force": {"force": 6.0}})
    fault, rise = SensorFault(kind="dead"), phantom_move(0.02, FASTEST)
    case = FaultCase(name="dead", sensor=fault, duration=2.0, move=rise, controller=strong)
    (result,) = run_faults([case])  # it dies when the contact carries all but 0.4 N
    assert held(result), fault_table([result])
    assert "reads nothing" in result.reasons[0]
    assert result.recovered


def test_without_the_guard_the_force_is_not_held():
    free = ProbeControllerParameters(guards=GuardParameters(enabled=False))
    case = FaultCase(
        name="frozen", phase="approach", sensor=SensorFault(kind="frozen"), duration=5.0, after=0,
        controller=free,
    )  # fmt: skip
    (result,) = run_faults([case])
    assert not held(result)
    assert result.peak > 20


@pytest.mark.slow
def test_two_hundred_faults_at_every_phase():
    results = run_faults(fault_cases())
    print(fault_table(results))
    assert len(results) >= 200
    bad = [each for each in results if not held(each)]
    assert not bad, fault_table(bad)
    # Where the body has gone for good, the probe does not follow it.
    stopped = [each for each in results if not each.recovered and "down" not in each.case.name]
    assert not stopped, fault_table(stopped)
    silent = [each for each in results if needs_reason(each) and not each.reasons]
    assert not silent, fault_table(silent)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["hydroelastic_with_fallback"])
def test_faults_with_the_stiffer_contact(model):
    cases = [case for case, _ in QUICK.values()] + list(ceiling_cases())
    results = run_faults(cases, model)
    print(fault_table(results))
    assert all(held(each) for each in results), fault_table(results)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("controller.force.force=1000", "controller.force.force: 1000.0 .* at most 8 N"),
        ("controller.guards.max_force=5", "guards.max_force"),
        ("controller.force.approach_speed=1", "controller.force.approach_speed: 1.0 .* 0.05 m/s"),
        ("controller.force.proportional_gain=1", "controller.force.proportional_gain: 1.0"),
        ("controller.visual_servo.gain=50", "controller.visual_servo.gain: 50.0 .* 10 1/s"),
        ("controller.kinematics.axis=[0, 0, 1]", "controller.kinematics.axis: .* the body"),
        ("controller.kinematics.axis=[1, 0, -0.5]", "controller.kinematics.axis: .* 60 deg"),
        ("controller_changes=[{time: 1, force: 50}]", "controller_changes.0.force: 50.0 .* 8 N"),
        ("station.sensor_faults=[{kind: odd}]", "station.sensor_faults.0.kind: 'odd'"),
    ],
)
def test_parameters_have_ceilings(change, message):
    changes = [change] + ["controller.force.force=4.5"] * ("max_force" in change)
    with pytest.raises(ConfigurationError, match=message):
        load_scenario("chatelain2013_fig5", changes=changes)


def test_parameters_at_their_ceilings_are_allowed():
    assert at_ceilings({"force": {"force": 8.0}}).force.force == 8.0
    load_scenario("chatelain2013_fig5", changes=["controller.kinematics.axis=[0, 0.5, -1]"])
