"""Time stamps of a device: whether they run, and how late they arrive."""

from collections import deque

# A stamp that has not changed for longer than this time in s, over three messages, stands.
_STANDS = 0.1
_RUNS = 3  # Number of successive stamps that tell whether a clock runs
_SET_ANEW = 1.0  # Change of the delay in s that no network makes: the clock was set anew
_FASTEST = 100  # Times real time at which nobody plays a recording: such stamps are not in s


class StreamClock:
    """The stamps of one device's messages, as they arrive; `last` is the last one, 0 is no clock's.

    A message's delay is that of its arrival after its stamp; the smallest is that of the clocks and
    of the fastest way. A clock ``stands`` if its stamps do not tell the time in s.
    """

    def __init__(self) -> None:
        self.stands = False
        self.last: float | None = None
        self._since, self._repeats, self._advances, self._leaps = 0.0, 0, 0, 0
        self._arrived = 0.0
        self._delays: deque[float] = deque(maxlen=64)

    def note(self, stamp: float, arrived: float) -> None:
        """Take in the stamp of a message that has just arrived."""
        step = abs(stamp - self.last) if self.last else 0.0
        leaps = step > max(_SET_ANEW, _FASTEST * (arrived - self._arrived))
        self._leaps = self._leaps + 1 if leaps else 0
        if stamp != self.last:
            self._since, self._repeats = arrived, 0
            self._advances += 1
            if self._advances > _RUNS and stamp != 0:
                self.stands = self._leaps >= _RUNS
        else:
            self._repeats += 1
            self._advances = 0
            if stamp == 0 or (self._repeats >= 2 and arrived - self._since > _STANDS):
                self.stands = True
        self.last, self._arrived = stamp, arrived
        delay = arrived - stamp
        if self._delays and abs(delay - self._delays[-1]) > _SET_ANEW:
            self._delays.clear()
        self._delays.append(delay)

    @property
    def steady(self) -> bool:
        """True if the last two messages or more took about the same time."""
        return len(self._delays) > 1

    @property
    def delay(self) -> float:
        """Time in s by which messages arrive after their stamps, of the fastest of late."""
        return min(self._delays)
