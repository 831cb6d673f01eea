"""The leaf that records a tracker's search in the volumes around a loss."""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.evaluation.explanation.explained_volume import (
    FOLDER,
    clear_explanations,
    explain_volume,
    write_explanation,
)
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.leaves import declare_looks, declare_memory
from sonoservo.systems.signals.localization_explanation import LocalizationExplanation
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.ports import declare_inputs, evaluate, evaluate_optional
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.volume import Volume

BEFORE, AFTER = "before", "after"
"""Names for the volumes kept because they precede or follow an occasion."""


class _Look(NamedTuple):
    """A volume that was searched, and the estimates before and after it."""

    volume: Volume
    explanation: LocalizationExplanation
    before: NeedleEstimate | None
    after: NeedleEstimate


@dataclass
class _Run:
    """Memory of a run: the volumes that may still be written, and the number that will be."""

    waiting: deque[_Look] = field(default_factory=deque)
    following: int = 0
    estimate: NeedleEstimate | None = None
    detected: bool = False
    begun: bool = False


class ExplanationRecorder(LeafSystem):
    """Records a tracker's search in the volumes around a loss, in one file for each.

    .. pydrake_system::

        name: ExplanationRecorder
        input_ports:
        - volume
        - estimate
        - explanation
        - detection (optional)

    A volume is kept when the tracker's mode changes, at the first detection and when the tip jumps
    (`find_occasion`), with some before and after it. `explanation` is evaluated after the tracker's
    update, when the gate has judged, which localizes the needle once more. A run removes the files
    of an earlier one.

    Parameters
    ----------
    folder
        Folder of the run; the files are in its subfolder ``explanation``.
    before, after
        Numbers of volumes to keep before and after an occasion.
    max_jump
        Largest distance of the tip from its expected position that is not a jump, in m.
    period, offset
        Period of the checks for a new volume and time of the first one, in s.
    """

    def __init__(
        self,
        *,
        folder: Path,
        before: int = 2,
        after: int = 2,
        max_jump: float = 3e-3,
        period: float = 1.0,
        offset: float = 0.0,
    ) -> None:
        super().__init__()
        require_positive(max_jump=max_jump)
        for name, count in (("before", before), ("after", after)):
            require(count >= 0, name, count, "0 or more")
        self._folder = folder
        self._before, self._after, self._max_jump = before, after, max_jump
        declare_inputs(
            self,
            volume=(Volume, NotFound),
            estimate=NeedleEstimate,
            explanation=(LocalizationExplanation, NotFound),
            detection=object,
        )
        self._run = declare_memory(self, _Run)
        declare_looks(self, self._look, period=period, offset=offset, start=self._start)

    def _start(self, context: Context) -> None:
        vars(self._run(context)).update(vars(_Run()))

    def _look(self, context: Context) -> None:
        """Process the volume if it is new and the estimate was made from it."""
        run = self._run(context)
        if not run.begun:
            clear_explanations(self._folder)
            (self._folder / FOLDER).mkdir(parents=True, exist_ok=True)
            run.begun = True
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        before, after = run.estimate, evaluate(self, context, "estimate", NeedleEstimate)
        if not isinstance(volume, Volume) or volume.time != after.volume_time:
            return
        if before is not None and before.volume_time >= volume.time:
            return
        explanation = evaluate(self, context, "explanation", (LocalizationExplanation, NotFound))
        if not isinstance(explanation, LocalizationExplanation):
            return
        first = bool(evaluate_optional(self, context, "detection", object)) and not run.detected
        occasion = find_occasion(before, after, detected=first, max_jump=self._max_jump)
        run.detected |= first
        run.estimate = after
        run.waiting.append(_Look(volume, explanation, before, after))
        if occasion:
            while len(run.waiting) > 1:
                self._write(run.waiting.popleft(), BEFORE)
            run.following = self._after + 1
        if run.following:
            self._write(run.waiting.popleft(), occasion or AFTER)
            run.following -= 1
        elif len(run.waiting) > self._before:
            run.waiting.popleft()

    def _write(self, look: _Look, occasion: str) -> None:
        volume, explanation, before, after = look
        explained = explain_volume(
            volume, explanation, before=before, after=after, occasion=occasion
        )
        write_explanation(self._folder, explained)


def find_occasion(
    before: NeedleEstimate | None, after: NeedleEstimate, *, detected: bool, max_jump: float
) -> str:
    """Return the reason why a volume is worth explaining; an empty text if it is not."""
    if before is None:
        return "first volume" if after.mode == TrackingMode.TRACKING else ""
    if before.mode != after.mode:
        return f"{before.mode} to {after.mode}"
    if detected:
        return "first detection"
    if before.curve is None or after.curve is None:
        return ""
    expected = before.curve.tip + before.tip_velocity * (after.time - before.time)
    jump = float(np.linalg.norm(after.curve.tip - expected))
    return f"tip jumped {1e3 * jump:.1f} mm" if jump > max_jump else ""
