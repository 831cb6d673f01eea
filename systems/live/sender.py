"""Base class of the leaves that send values over a live connection."""

from abc import abstractmethod
from typing import Protocol

from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.live.connection.items import Item
from sonoservo.systems.signals.requirements import require_not_negative, require_positive

KEEP = 2
"""Number of large values that wait for a slow receiver; it gets the newest."""


class Outlet(Protocol):
    """Destination of items: a `Link`, or its stand-in in a test."""

    def send(self, items: list[Item], topic: str = "", keep: int | None = None) -> None:
        """Send items together, or drop them together; never wait."""
        ...


class Sender(LeafSystem):
    """Sends what its inputs hold, at fixed times or whenever it is asked to publish.

    Parameters
    ----------
    outlet
        Connections to send to.
    period, offset
        Period and offset of the times at which it sends, in s.
    """

    def __init__(self, *, outlet: Outlet, period: float, offset: float = 0.0) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._outlet = outlet
        self._start()
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(period, offset, self._publish)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        """Forget the values of an earlier run."""
        self._newest = -float("inf")

    def _is_new(self, time: float) -> bool:
        """Note the time of a value in s; return True if no value of that time or later was seen."""
        new = time > self._newest
        if new:
            self._newest = time
        return new

    @abstractmethod
    def _publish(self, context: Context) -> None:
        """Send what the inputs hold, if it is new."""
