"""Occasions at which a volume is worth explaining."""

import numpy as np

from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

BEFORE, AFTER = "before", "after"
"""Occasions of the volumes that are kept because they lie around one."""


def find_occasion(
    before: NeedleEstimate | None, after: NeedleEstimate, *, detected: bool, max_jump: float
) -> str:
    """Return why a volume is worth explaining; an empty text if it is not.

    Parameters
    ----------
    before, after
        Estimates before and after the volume; None before the first one.
    detected
        Whether this is the first volume in which an insertion was detected.
    max_jump
        Distance in m up to which the tip may lie from where it was expected to go.
    """
    if before is None:
        return "first volume" if after.mode == TrackingMode.TRACKING else ""
    if before.mode != after.mode:
        return f"{before.mode} to {after.mode}"
    if detected:
        return "first detection"
    jump = tip_jump(before, after)
    return f"tip jumped {1e3 * jump:.1f} mm" if jump > max_jump else ""


def tip_jump(before: NeedleEstimate, after: NeedleEstimate) -> float:
    """Distance in m of a tip from where the estimate before let it expect; 0 without either."""
    if before.curve is None or after.curve is None:
        return 0.0
    expected = before.curve.tip + before.tip_velocity * (after.time - before.time)
    return float(np.linalg.norm(after.curve.tip - expected))
