"""Faults in the loop: what the guard must hold, with the true contact force as judge."""

import re
from pathlib import Path

import pytest
from fault_runs import GUARDS, Fault, FaultCase, FaultLoop, changed, draw_case, rise, run_faults

from sonoservo.diagrams import (
    FollowingExperiment,
    MakeProbeController,
    ProbeControllerParameters,
    load_scenario,
)
from sonoservo.models import model_path
from sonoservo.systems.control import GuardParameters
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.robot import Breathing, PhantomMotionParameters

PAGE = Path(__file__).parents[2] / "notebooks/docs/robot.md"


def body(*moves, **breathing):
    return PhantomMotionParameters(moves=list(moves), breathing=Breathing(**breathing))


UP = body(rise(0.02, 0.1, start=1.7))
"""The body comes 20 mm up at 10 cm/s."""


def fault(kind, value=0.0, **more):
    return Fault(kind=kind, value=value, **more)


def row(*faults, motion=UP, **more):
    return FaultCase(faults=faults, motion=motion, **more)


ROWS = {
    "samples are not numbers": row(fault("nan")),
    "samples out of range, saturated": row(fault("saturated", 70)),
    "samples frozen": row(fault("frozen")),
    "samples zero: the sensor is dead": row(fault("dead")),
    "stuck at a plausible value, with noise": row(
        fault("saturated", -5.6, start=0.2, duration=60), phase="approach"
    ),
    "biased by 5 N": row(fault("bias", 5)),
    "biased by -3 N": row(fault("bias", -3)),
    "biased by 1.4 N": row(fault("bias", -1.4, duration=4.5)),
    "drifts by 5 N/s": row(fault("drift", -5)),
    "jumps by 20 N in every other sample": row(fault("jumping", 20)),
    "late by 50 ms": row(latency=0.05),
    "late by 300 ms": row(latency=0.3),
    "torques are not numbers": row(fault("nan", where="arm")),
    "torques frozen": row(fault("frozen", where="arm")),
    "torques biased by 2 N m": row(fault("bias", -2, where="arm")),
    "pose is not a number": row(fault("nan", where="pose")),
    "pose 30 mm off": row(fault("jump", where="pose")),
    "gain or force target is not a number": row(
        fault("nan", where="gain"), fault("nan", where="force")
    ),
    "body rises 50 mm at 10 cm/s": row(motion=body(rise(0.05, 0.1))),
    "body sinks 30 mm": row(motion=body(rise(-0.03, 0.05))),
    "body breathes by 15 mm": row(
        motion=body(peak_to_peak=0.015, rate=0.5, direction=[0, 0, 1]), duration=6.0
    ),
    "no second witness: stuck": row(
        fault("saturated", -5.6, start=0.2, duration=60), phase="approach", motion=body(),
        alone=True,
    ),
    "both witnesses wrong: stuck and dead": row(
        fault("saturated", -5.6, start=0.2, duration=60),
        fault("dead", where="arm", start=0.2, duration=60),
        phase="approach", motion=body(),
    ),
}  # fmt: skip
"""Causes of the page's table. In most rows the body rises 20 mm at 10 cm/s during the fault."""


@pytest.fixture(scope="module")
def loops():
    default = ProbeControllerParameters()
    return {alone: FaultLoop(default, alone) for alone in (False, True)}


def page_rows():
    """Rows of the page's table: cause, how it is noticed, what is done, peak and what is left."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    cells = [[each.strip() for each in line.strip("|").split("|")] for line in lines]
    return {row[0]: row[1:] for row in cells if row[0] in ROWS}


def test_the_page_has_a_row_for_each_cause():
    assert list(page_rows()) == list(ROWS)


QUICK = (
    "samples are not numbers", "samples out of range, saturated", "biased by 5 N",
    "late by 300 ms", "torques are not numbers", "pose 30 mm off", "body rises 50 mm at 10 cm/s",
    "no second witness: stuck", "both witnesses wrong: stuck and dead",
)  # fmt: skip
"""One row for each way in which a fault is noticed; the others are slow."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in ROWS]
)
def test_each_row_of_the_page_is_what_happens(loops, name):
    noticed, reaction, peak, _ = page_rows()[name]
    result = loops[ROWS[name].alone].run(ROWS[name])
    for words in re.findall(r"\*(.+?)\*", noticed):
        assert any(words in each for each in result.reasons), result
    assert bool(result.reasons) == ("*" in noticed)
    assert result.peak == pytest.approx(float(peak), abs=0.75)
    assert ("goes on" in reaction) == result.recovered
    if name.startswith("both"):
        assert result.longest_above == pytest.approx(1.0, abs=0.15)
    else:
        assert not result.faults, result


def test_an_arm_without_torques_may_not_press_hard(tmp_path):
    text = model_path("robots/viper_s850.yaml").read_text()
    arm = tmp_path / "viper.yaml"
    urdf = model_path("robots/viper_s850.urdf")
    arm.write_text(re.sub("torque_error.*", "", text).replace("viper_s850.urdf", str(urdf)))
    hard = changed({"force": {"force": 4.0}})
    with pytest.raises(ValueError, match="force.force: 4.0 .* at most 3 N, because the arm"):
        MakeProbeController(parameters=hard, arm=str(arm))
    controller = MakeProbeController(parameters=ProbeControllerParameters(), arm=str(arm))
    assert not controller.HasInputPort("external_torque")
    changes = [f"station.arm={arm}", "duration=0.2"]
    experiment = FollowingExperiment(load_scenario("chatelain2013_fig5", changes=changes))
    experiment.run()
    noticed = experiment.summarize(experiment.log())["guard"]["noticed"]
    assert "nothing but the wrist's sensor tells the force" in noticed


def test_without_the_guard_the_force_is_not_held():
    free = ProbeControllerParameters(guards=GuardParameters(enabled=False))
    case = FaultCase(
        phase="approach", faults=(fault("frozen", start=0.3, duration=60),), duration=5.0,
        controller=free,
    )  # fmt: skip
    (result,) = run_faults([case])
    assert result.peak > 20


@pytest.mark.parametrize("end", [0, 1])
def test_the_guard_holds_at_the_ends_of_its_own_parameters(end):
    ends = changed({"guards": {name: values[end] for name, values in GUARDS.items()}})
    (result,) = run_faults([FaultCase(faults=(fault("nan"),), motion=UP, controller=ends)])
    assert not result.faults, result


@pytest.mark.parametrize(
    "seeds", [range(2), pytest.param(range(100, 400), marks=pytest.mark.slow)], ids=len
)
def test_faults_that_a_seed_draws(seeds):
    bad = [each for each in run_faults(map(draw_case, seeds)) if each.faults]
    assert not bad


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("controller.force.force=1000", "controller.force.force: 1000.0 .* at most 8 N"),
        ("controller.guards.max_force=5", "guards.max_force"),
        ("controller.guards.retreat_speed=1e-4", "retreat_speed: 0.0001 .* from 0.1 to 0.5"),
        ("controller.kinematics.axis=[1, 0, -0.5]", "controller.kinematics.axis: .* 60 deg"),
        ("controller_changes=[{time: 1, force: 50}]", "controller_changes.0.force: 50.0 .* 8 N"),
        ("station.sensor_faults=[{kind: odd}]", "station.sensor_faults.0.kind: 'odd'"),
    ],
)
def test_parameters_have_floors_and_ceilings(change, message):
    changes = [change] + ["controller.force.force=4.5"] * ("max_force" in change)
    with pytest.raises(ConfigurationError, match=message):
        load_scenario("chatelain2013_fig5", changes=changes)
