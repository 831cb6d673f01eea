"""Occasions on which a volume is worth explaining."""

import numpy as np

from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

BEFORE, AFTER = "before", "after"
"""Names for the volumes kept because they precede or follow an occasion."""


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
    jump = tip_jump(before, after)
    return f"tip jumped {1e3 * jump:.1f} mm" if jump > max_jump else ""


def tip_jump(before: NeedleEstimate, after: NeedleEstimate) -> float:
    """Return the distance in m of a tip from its expected position; 0 if there is no curve."""
    if before.curve is None or after.curve is None:
        return 0.0
    expected = before.curve.tip + before.tip_velocity * (after.time - before.time)
    return float(np.linalg.norm(after.curve.tip - expected))
