"""Detection of something that has just entered the field of view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only


@dataclass(frozen=True, eq=False)
class InsertionDetection(Immutable):
    """Detected insertion. If there is none, a `NotFound` takes its place.

    Parameters
    ----------
    p_WEntry, p_WMedian, p_WTip
        (3,) candidate entry point E_t on the side of the field of view, geometric median of the
        candidates, and geometric median of the half farther from the entry, in W, in m.
    std
        Square root of the trace of the candidates' covariance, in m.
    change
        Smallest difference among the candidates, in dB.
    time
        Time at which the tip was acquired, in s.
    """

    p_WEntry: NDArray[np.float64]
    p_WMedian: NDArray[np.float64]
    p_WTip: NDArray[np.float64]
    std: float
    change: float
    time: float

    def __post_init__(self) -> None:
        for name in ("p_WEntry", "p_WMedian", "p_WTip"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, (3,)))
