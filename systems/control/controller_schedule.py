"""Schedule of controller settings, each of which holds until the next change."""

from bisect import bisect_right
from dataclasses import dataclass, replace

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
