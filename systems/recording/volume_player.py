"""Leaf system that plays recorded volumes."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.recording.recording import Recording
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import declare_output
from sonoservo.systems.signals.requirements import require, require_not_negative
from sonoservo.systems.signals.volume import Volume


class VolumePlayer(LeafSystem):
    """Outputs recorded volumes at the times of their acquisition, as a scanner would.

    .. pydrake_system::

        name: VolumePlayer
        output_ports:
        - volume

    The player is stateless: its output is the newest volume whose time plus ``delay`` has passed,
    or a `NotFound` before the first. A volume is read from the file on demand.

    Parameters
    ----------
    recording
        Recording or volumes to play.
    start
        Time of the first volume in the simulation, in s; None keeps the recording's own times. The
        volumes keep their own times in either case.
    delay
        Time from a volume's own time, the middle of its acquisition, to its output, in s.
    """

    def __init__(
        self,
        *,
        recording: Recording | Sequence[Volume],
        start: float | None = None,
        delay: float = 0.0,
    ) -> None:
        super().__init__()
        require(len(recording) > 0, "recording", len(recording), "at least one volume")
        require_not_negative(delay=delay)
        if isinstance(recording, Recording):
            times = recording.times
        else:
            times = np.array([volume.time for volume in recording])
        shift = 0.0 if start is None else start - times[0]
        self._due = times + shift + delay
        # The framework evaluates the port again after every event; a volume is read only once.
        self._read = lru_cache(maxsize=1)(recording.__getitem__)
        declare_output(self, "volume", (Volume, NotFound), self._calc_volume, {self.time_ticket()})

    @property
    def end(self) -> float:
        """Time in the simulation at which the last volume is due, in s."""
        return float(self._due[-1])

    def _calc_volume(self, context: Context, output: Value) -> None:
        number = int(np.searchsorted(self._due, context.get_time() + 1e-9, side="right")) - 1
        due = self._read(number) if number >= 0 else NotFound("no volume is due yet")
        output.set_value(due)
