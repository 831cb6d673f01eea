"""Leaf system that passes on an operator's controller settings and records them as a schedule."""

from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from sonoservo.systems.control.controller_schedule import ControllerSchedule, ControllerSettings


class OperatorSettings(LeafSystem):
    """Outputs the controller settings that an operator asks for, from the next sample onwards.

    .. pydrake_system::

        name: OperatorSettings
        input_ports:
        - controller_target
        output_ports:
        - gain
        - force_target

    `controller_target` is the wanted lambda in 1/s and the wanted force in N. The state is the
    schedule of all changes so far. A `ScheduledSettings` system replays it.

    Parameters
    ----------
    start
        Initial settings.
    period
        Sampling period, in s.
    """

    def __init__(self, *, start: ControllerSettings, period: float = 1 / 16) -> None:
        super().__init__()
        self.DeclareVectorInputPort("controller_target", 2)
        self.DeclareAbstractState(Value[object](ControllerSchedule(start)))
        for name, calc in (("gain", self._calc_gain), ("force_target", self._calc_force_target)):
            self.DeclareVectorOutputPort(name, 1, calc, prerequisites_of_calc={self.xa_ticket()})
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def schedule(self, context: Context) -> ControllerSchedule:
        """Return the schedule of all changes so far."""
        schedule: ControllerSchedule = context.get_abstract_state(0).get_value()
        return schedule

    def _update(self, context: Context, state: State) -> None:
        gain, force = self.GetInputPort("controller_target").Eval(context).tolist()
        schedule = self.schedule(context).followed_by(
            ControllerSettings(gain, force), context.get_time()
        )
        state.get_mutable_abstract_state(0).set_value(schedule)

    def _calc_gain(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.schedule(context).last.gain)

    def _calc_force_target(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.schedule(context).last.force)
