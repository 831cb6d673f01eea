"""Detection of something that has just entered the field of view."""

from dataclasses import dataclass

from sonoservo.systems.signals.immutable import Immutable, Vector3


@dataclass(frozen=True, eq=False)
class InsertionDetection(Immutable):
    """Detected insertion, in W, in m. If there is none, a `NotFound` takes its place."""

    p_WEntry: Vector3
    """Candidate entry point E_t on the side of the field of view."""

    p_WMedian: Vector3
    """Geometric median of the candidates."""

    p_WTip: Vector3
    """Geometric median of the half farther from the entry."""

    std: float
    """Square root of the trace of the candidates' covariance."""

    change: float
    """Smallest difference among the candidates, in dB."""

    time: float
    """Time at which the tip was acquired, in s."""
