from pydrake.systems.analysis import Simulator

from sonoservo.systems.control import OperatorSettings, ScheduledSettings
from sonoservo.systems.control.controller_schedule import (
    ControllerChange,
    ControllerSchedule,
    ControllerSettings,
)

START = ControllerSettings(gain=1.6, force=2.0)


def test_a_change_holds_from_its_time_until_the_next():
    changes = (ControllerChange(time=1.0, gain=0.5), ControllerChange(time=2.0, force=3.0))
    schedule = ControllerSchedule(START, changes)
    assert schedule.at(0.999) == START
    assert schedule.at(1.0) == ControllerSettings(0.5, 2.0)
    assert schedule.at(99.0) == ControllerSettings(0.5, 3.0)
    between = schedule.with_change(ControllerChange(time=1.5, force=4.0))
    assert between.at(1.7) == ControllerSettings(0.5, 4.0)
    assert between.at(2.0) == ControllerSettings(0.5, 3.0)  # as planned


def test_planned_changes_hold_beside_the_operator_s_and_all_are_recorded():
    planned = ControllerSchedule(START, (ControllerChange(time=1.0, gain=0.5),))
    driven = OperatorSettings(schedule=planned, period=1 / 16)
    simulator = Simulator(driven)
    context = simulator.get_mutable_context()
    for time, wanted, held in (
        (0.47, [1.6, 2.0], [1.6, 2.0]),
        (1.47, [1.6, 3.0], [0.5, 3.0]),
        (2.47, [1.0, 3.0], [1.0, 3.0]),
    ):
        driven.GetInputPort("controller_target").FixValue(context, wanted)
        simulator.AdvanceTo(time)
        assert held == outputs(driven, context)
    changes = driven.schedule(context).changes
    assert [each.time for each in changes] == [0.5, 1.0, 1.5]
    again = ScheduledSettings(schedule=ControllerSchedule(START, changes))
    context = again.CreateDefaultContext()
    for time, held in ((0.47, [1.6, 2.0]), (1.47, [0.5, 3.0]), (2.47, [1.0, 3.0])):
        context.SetTime(time)
        assert held == outputs(again, context)


def outputs(system, context):
    return [system.GetOutputPort(name).Eval(context)[0] for name in ("gain", "force_target")]
