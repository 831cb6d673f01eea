"""Leaf system that passes on an operator's controller settings and records them as a schedule."""

from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import Context, State

from sonoservo.systems.control.controller_schedule import ControllerChange, ControllerSchedule
from sonoservo.systems.control.scheduled_settings import ScheduledSettings


class OperatorSettings(ScheduledSettings):
    """Outputs the controller settings that an operator asks for, from the next sample onwards.

    .. pydrake_system::

        name: OperatorSettings
        input_ports:
        - controller_target
        output_ports:
        - gain
        - force_target

    `controller_target` is the wanted lambda in 1/s and the wanted force in N. The state is the
    schedule with all changes so far, and the last target. A setting that the operator moves holds
    until the next planned change. A `ScheduledSettings` system replays the schedule.

    Parameters
    ----------
    schedule
        Initial settings and planned changes. The operator's target has to begin with the former.
    period
        Sampling period, in s.
    """

    def __init__(self, *, schedule: ControllerSchedule, period: float = 1 / 16) -> None:
        super().__init__(schedule=schedule)
        self.DeclareVectorInputPort("controller_target", 2)
        self.DeclareAbstractState(Value[object](schedule))
        start = schedule.start
        self.DeclareAbstractState(Value[object]({"gain": start.gain, "force": start.force}))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def schedule(self, context: Context) -> ControllerSchedule:
        """Return the schedule of all changes so far."""
        schedule: ControllerSchedule = context.get_abstract_state(0).get_value()
        return schedule

    def _update(self, context: Context, state: State) -> None:
        target = self.GetInputPort("controller_target").Eval(context).tolist()
        wanted = dict(zip(("gain", "force"), target, strict=True))
        before: dict[str, float] = context.get_abstract_state(1).get_value()
        moved: dict[str, Any] = {n: each for n, each in wanted.items() if each != before[n]}
        if moved:
            change = ControllerChange(time=context.get_time(), **moved)
            schedule = self.schedule(context).with_change(change)
            state.get_mutable_abstract_state(0).set_value(schedule)
            state.get_mutable_abstract_state(1).set_value(wanted)
