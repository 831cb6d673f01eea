"""The leaf that feeds the console of a run: each new volume, and samples of the strips."""

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.display.console.readings import sample_estimate, tip_error
from sonoservo.systems.signals.guard_status import GuardStatus
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks
from sonoservo.systems.signals.line_hypotheses import LineHypotheses
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.ports import declare_inputs, evaluate, evaluate_optional
from sonoservo.systems.signals.volume import Volume

if TYPE_CHECKING:  # a run without a page does not import it
    from sonoservo.systems.display.console.console import Console

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
        self._console = console
        self._start()
        declare_inputs(
            self,
            X_WP=RigidTransform,
            X_WT=RigidTransform,
            volume=(Volume, NotFound),
            needle=Needle,
            estimate=NeedleEstimate,
            guard=GuardStatus,
            hold_reason=str,
            lines=(LineHypotheses, NotFound),
            contact_force=1,
            force_target=1,
        )
        declare_looks(self, self._show, period=period, offset=offset, start=self._start)
        declare_looks(self, self._sample, period=_SAMPLING)

    def _start(self, context: Context | None = None) -> None:
        self._volume_time = -float("inf")
        self._number = 0
        self._tips: deque[tuple[float, Any]] = deque(maxlen=_TIPS)

    def _show(self, context: Context) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        if not isinstance(volume, Volume) or volume.time <= self._volume_time:
            return
        self._volume_time = volume.time
        self._number += 1
        estimate = evaluate_optional(self, context, "estimate", NeedleEstimate)
        self._console.show_volume(volume, estimate, self._number, self._lines(context))

    def _lines(self, context: Context) -> LineHypotheses | None:
        lines = evaluate_optional(self, context, "lines", (LineHypotheses, NotFound))
        return lines if isinstance(lines, LineHypotheses) else None

    def _sample(self, context: Context) -> None:
        time = context.get_time()
        X_WP, X_WT = (
            evaluate_optional(self, context, name, RigidTransform) for name in ("X_WP", "X_WT")
        )
        needle = evaluate_optional(self, context, "needle", Needle)
        estimate = evaluate_optional(self, context, "estimate", NeedleEstimate)
        guard = evaluate_optional(self, context, "guard", GuardStatus)
        values: dict[str, Any] = {
            "held": evaluate_optional(self, context, "hold_reason", str) or "",
            "stopped": guard.reason if guard is not None and guard.stopped else "",
        }
        if needle is not None:
            values["inserted"] = 1e3 * needle.length
        if needle and X_WT is not None:
            self._tips.append((time, X_WT.multiply(needle.tip)))
        else:
            self._tips.clear()
        if estimate is not None:
            values["error"] = tip_error(estimate, self._tips)
        for name, port in (("force", "contact_force"), ("target", "force_target")):
            vector = evaluate_optional(self, context, port, np.ndarray)
            if vector is not None:
                values[name] = float(vector[0])
        lines = self._lines(context)
        self._console.add(
            sample_estimate(time, estimate, X_WP or RigidTransform(), lines, **values)
        )
