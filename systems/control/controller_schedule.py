"""Schedule of controller settings; leaf systems that play it, or record an operator's changes."""

from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem, State

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import Bounded, NotNegative, Positive, Time


@dataclass(kw_only=True)
class ControllerChange(Bounded):
    """One change of the controller's settings during a run.

    Parameters
    ----------
    time
        Time from which the change holds, in s.
    gain
        Gain lambda of the visual servo, in 1/s; None leaves it unchanged.
    force
        Pressing force, in N; None leaves it unchanged.
    """

    time: Time = 0.0
    gain: NotNegative | None = None
    force: Positive | None = None


@dataclass(frozen=True)
class ControllerSettings(Immutable):
    """Gain lambda of the visual servo in 1/s, and pressing force in N."""

    gain: float
    force: float


class ControllerSchedule(Immutable):
    """Settings as a function of time: those at the start, and changes in order of time."""

    def __init__(self, start: ControllerSettings, changes: tuple[ControllerChange, ...] = ()):
        self.start, self.changes = start, changes
        self._times = [change.time for change in changes]
        self._settings = [start]
        for change in changes:
            new = {"gain": change.gain, "force": change.force}
            changed = {name: value for name, value in new.items() if value is not None}
            self._settings.append(replace(self._settings[-1], **changed))

    def at(self, time: float) -> ControllerSettings:
        """Return the settings that hold at a time in s; a change holds from its own time on."""
        return self._settings[bisect_right(self._times, time)]

    def with_change(self, change: ControllerChange) -> "ControllerSchedule":
        """Return this schedule with one more change; those at later times still follow."""
        number = bisect_right(self._times, change.time)
        before, after = self.changes[:number], self.changes[number:]
        return ControllerSchedule(self.start, (*before, change, *after))


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
