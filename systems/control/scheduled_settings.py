"""Leaf system that outputs controller settings from a schedule."""

from pydrake.systems.framework import BasicVector, Context, LeafSystem

from sonoservo.systems.control.controller_schedule import ControllerSchedule


class ScheduledSettings(LeafSystem):
    """Outputs the controller settings that a schedule holds for the present time.

    .. pydrake_system::

        name: ScheduledSettings
        output_ports:
        - gain
        - force_target

    `gain` is lambda in 1/s, and `force_target` is in N.

    Parameters
    ----------
    schedule
        Settings as a function of time.
    """

    def __init__(self, *, schedule: ControllerSchedule) -> None:
        super().__init__()
        self._schedule = schedule
        for name, calc in (("gain", self._calc_gain), ("force_target", self._calc_force_target)):
            read = {self.xa_ticket(), self.time_ticket()}
            self.DeclareVectorOutputPort(name, 1, calc, prerequisites_of_calc=read)

    def schedule(self, context: Context) -> ControllerSchedule:
        """Return the schedule that holds."""
        return self._schedule

    def _calc_gain(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.schedule(context).at(context.get_time()).gain)

    def _calc_force_target(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.schedule(context).at(context.get_time()).force)
