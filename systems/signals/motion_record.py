"""Motion of a sweep as it was measured, beside the true one."""

from dataclasses import dataclass

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.sweep import SweepMotion


@dataclass(frozen=True, eq=False)
class MotionRecord(Immutable):
    """Times and poses of a sweep's frames, as measured and in truth; for logs only.

    Parameters
    ----------
    measured
        Motion that the sweep carries.
    true
        Motion by which it was acquired.
    """

    measured: SweepMotion
    true: SweepMotion
