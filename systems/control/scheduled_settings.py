"""Leaf: settings of the controller that follow a schedule."""

from pydrake.systems.framework import BasicVector, Context, LeafSystem

from sonoservo.systems.control.controller_schedule import ControllerSchedule


class ScheduledSettings(LeafSystem):
    """Gives the controller its settings over time.

    .. pydrake_system::

        name: ScheduledSettings
        output_ports:
        - gain
        - force_target

    `gain` is lambda in 1/s, `force_target` in N.

    Parameters
    ----------
    schedule
        What is changed when.
    """

    def __init__(self, *, schedule: ControllerSchedule) -> None:
        super().__init__()
        self._schedule = schedule
        for name, calc in (("gain", self._calc_gain), ("force_target", self._calc_force_target)):
            self.DeclareVectorOutputPort(name, 1, calc, prerequisites_of_calc={self.time_ticket()})

    def _calc_gain(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._schedule.at(context.get_time()).gain)

    def _calc_force_target(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self._schedule.at(context.get_time()).force)
