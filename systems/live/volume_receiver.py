"""The leaf through which live volumes enter a diagram."""

import time
from collections.abc import Callable

from pydrake.common.value import Value
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from sonoservo.systems.live.live_source import LiveSource
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_state_output
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.volume import Volume


class VolumeReceiver(LeafSystem):
    """Gives the newest volume of a live connection.

    .. pydrake_system::

        name: VolumeReceiver
        output_ports:
        - volume

    A message becomes an event of this system, as in ROS' subscriber for Drake: it is taken in at
    the start of the next step, and only then the output changes. (Python cannot say when a
    system's next event is, so it looks at every step, which costs a microsecond.) A program that
    is driven by volumes instead of a simulator forces the event.

    `volume` is a `Volume`, or a `NotFound` with the reason while there is none, or while the last
    one is too old.

    Parameters
    ----------
    source
        Source of the volumes.
    stale_after
        Time in s, of the real clock, after which a volume is too old.
    clock
        Real time, in s.
    """

    def __init__(
        self,
        *,
        source: LiveSource,
        stale_after: float = 2.0,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        super().__init__()
        require_positive(stale_after=stale_after)
        self._source, self._stale_after, self._clock = source, stale_after, clock
        self._since = clock()
        self._volume = self.DeclareAbstractState(Value[object](NotFound("no volume has come yet")))
        declare_state_output(self, "volume", (Volume, NotFound), self._volume)
        self.DeclareInitializationUnrestrictedUpdateEvent(self._update)
        self.DeclarePerStepUnrestrictedUpdateEvent(self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _update(self, context: Context, state: State) -> EventStatus:
        taken = self._source.take()
        if isinstance(taken, Volume):
            self._since = self._clock()
        else:
            known = context.get_abstract_state(self._volume).get_value()
            fresh = self._clock() - self._since <= self._stale_after
            if fresh or not isinstance(known, Volume):
                return EventStatus.DidNothing()
            taken = NotFound(f"{taken.reason} for {self._stale_after:g} s")
        state.get_mutable_abstract_state(self._volume).set_value(taken)
        return EventStatus.Succeeded()
