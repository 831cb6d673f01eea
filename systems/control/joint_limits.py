"""Check of joint commands against the limits of the joints."""

from typing import Any

from numba import njit


@njit(cache=True)
def keeps_limits(wanted: Any, last: Any, limits: Any) -> bool:  # pragma: no cover - compiled
    """Return True if a command keeps the limits of the joints and continues the last one.

    Parameters
    ----------
    wanted
        (2n,) joint positions and velocities, in rad and rad/s.
    last
        At least (2n,) numbers: those sent last. Nothing has to be continued where they are NaN.
    limits
        (3, 2n) least and greatest values, and largest changes from one command to the next.
    """
    for i in range(len(wanted)):
        if not limits[0, i] <= wanted[i] <= limits[1, i]:
            return False
        if abs(wanted[i] - last[i]) > limits[2, i]:
            return False
    return True
