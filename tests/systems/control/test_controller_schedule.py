from pydrake.systems.analysis import Simulator

from sonoservo.systems.control import OperatorSettings, ScheduledSettings
from sonoservo.systems.control.controller_schedule import (
    ControllerChange,
    ControllerSchedule,
    ControllerSettings,
)

START = ControllerSettings(gain=1.6, force=2.0)


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
    for time, held in ((0.47, [1.6, 2.0]), (1.0, [0.5, 3.0]), (1.47, [0.5, 3.0]), (9, [1.0, 3.0])):
        context.SetTime(time)
        assert held == outputs(again, context)


def outputs(system, context):
    return [system.GetOutputPort(name).Eval(context)[0] for name in ("gain", "force_target")]
