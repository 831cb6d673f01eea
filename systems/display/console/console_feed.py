"""The leaf that feeds the console of a run: each new volume, and samples of the strips."""

from collections import deque
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.display.console.readings import sample_estimate, tip_error
from sonoservo.systems.signals.guard_status import GuardStatus
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.line_hypotheses import LineHypotheses
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import declare_inputs, evaluate
from sonoservo.systems.signals.requirements import require_not_negative, require_positive
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:  # a run without a page does not import it
    from sonoservo.systems.display.console.console import Console

T = TypeVar("T")

_SAMPLING = 1 / 8  # Time between samples of the strips, in s
_TIPS = 64  # Number of samples of the true tip that estimates are compared with


class ConsoleFeed(LeafSystem):
    """Shows each new volume, the estimated needle in it and the state of the run on a console.

    .. pydrake_system::

        name: ConsoleFeed
        input_ports:
        - volume
        - X_WP (optional)
        - X_WT (optional)
        - needle (optional)
        - estimate (optional)
        - contact_force (optional)
        - force_target (optional)
        - guard (optional)
        - hold_reason (optional)
        - lines (optional)

    `volume` is a `Volume`, or a `NotFound` while there is none, and `estimate` a `NeedleEstimate`.
    The true `needle`, a `Needle` in T, and `contact_force` serve the display only. `lines` are the
    `LineHypotheses` of a tracker that tells which lines it follows. Volumes are counted from 1 in
    each run.

    Parameters
    ----------
    console
        Console to feed.
    period, offset
        Period of the checks for a new volume and time of the first one, in s: shortly after the
        tracker's.
    """

    def __init__(self, *, console: "Console", period: float, offset: float = 0.0) -> None:
        super().__init__()
        require_positive(period=period)
        require_not_negative(offset=offset)
        self._console = console
        self._start()
        for name in ("X_WP", "X_WT"):
            self.DeclareAbstractInputPort(name, Value(RigidTransform()))
        declare_inputs(
            self,
            volume=(Volume, NotFound),
            needle=Needle,
            estimate=NeedleEstimate,
            guard=GuardStatus,
            hold_reason=str,
            lines=(LineHypotheses, NotFound),
        )
        for name in ("contact_force", "force_target"):
            self.DeclareVectorInputPort(name, 1)
        self.DeclareInitializationPublishEvent(publish=lambda context: self._start())
        self.DeclarePeriodicPublishEvent(_SAMPLING, 0.0, self._sample)
        self.DeclarePeriodicPublishEvent(period, offset, self._show)
        self.DeclareForcedPublishEvent(self._publish)

    def _start(self) -> None:
        self._volume_time = -float("inf")
        self._number = 0
        self._tips: deque[tuple[float, Any]] = deque(maxlen=_TIPS)

    def _value(self, context: Context, port: str, expected: type[T]) -> T | None:
        if self.GetInputPort(port).HasValue(context):
            return evaluate(self, context, port, expected)
        return None

    def _publish(self, context: Context) -> None:
        self._show(context)
        self._sample(context)

    def _show(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        if not isinstance(volume, Volume) or volume.time <= self._volume_time:
            return
        self._volume_time = volume.time
        self._number += 1
        estimate = self._value(context, "estimate", NeedleEstimate)
        self._console.show_volume(volume, estimate, self._number, self._lines(context))

    def _lines(self, context: Context) -> LineHypotheses | None:
        if not self.GetInputPort("lines").HasValue(context):
            return None
        lines = evaluate(self, context, "lines", (LineHypotheses, NotFound))
        return lines if isinstance(lines, LineHypotheses) else None

    def _sample(self, context: Context) -> None:
        time = context.get_time()
        estimate = self._value(context, "estimate", NeedleEstimate)
        values: dict[str, Any] = {}
        X_WT = self._value(context, "X_WT", RigidTransform)
        needle = self._value(context, "needle", Needle)
        values["inserted"] = 1e3 * needle.length if needle is not None else float("nan")
        if needle and X_WT is not None:
            self._tips.append((time, X_WT.multiply(needle.tip)))
        else:
            self._tips.clear()
        if estimate is not None:
            values["error"] = tip_error(estimate, self._tips)
        for name, port in (("force", "contact_force"), ("target", "force_target")):
            vector = self._value(context, port, np.ndarray)
            if vector is not None:
                values[name] = float(vector[0])
        guard = self._value(context, "guard", GuardStatus)
        if guard is not None and guard.stopped:
            values["stopped"] = guard.reason
        values["held"] = self._value(context, "hold_reason", str) or ""
        X_WP = self._value(context, "X_WP", RigidTransform) or RigidTransform()
        lines = self._lines(context)
        self._console.add(sample_estimate(time, estimate, X_WP, lines, **values))
