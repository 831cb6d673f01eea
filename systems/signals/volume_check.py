"""Result of the plausibility check of the volumes before a tracker."""

from dataclasses import dataclass

from sonoservo.systems.signals.immutable import Immutable


@dataclass(frozen=True)
class VolumeCheck(Immutable):
    """Volumes accepted and refused so far.

    Parameters
    ----------
    accepted, refused
        Numbers of volumes.
    reason
        Reason why the newest volume was refused; empty if it was accepted.
    """

    accepted: int = 0
    refused: int = 0
    reason: str = ""
