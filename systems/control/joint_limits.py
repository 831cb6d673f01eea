"""Check of joint commands against the limits of the joints."""

from typing import Any

from numba import njit


@njit(cache=True)
def keeps_limits(wanted: Any, last: Any, limits: Any) -> bool:  # pragma: no cover - compiled
    """Return True if a command keeps the limits of the joints and continues the last one.

    Both hold positions and velocities, the last one NaN where nothing has to be continued. The (3,
    2n) limits are least and greatest values, and largest changes.
    """
    for i in range(len(wanted)):
        if not limits[0, i] <= wanted[i] <= limits[1, i]:
            return False
        if abs(wanted[i] - last[i]) > limits[2, i]:
            return False
    return True
