"""Status of the guard between controller and arm."""

from dataclasses import dataclass
from enum import StrEnum

from sonoservo.systems.signals.immutable import Immutable


class GuardState(StrEnum):
    """States of the guard."""

    MONITORING = "monitoring"
    """The controller's commands pass unchanged."""
    RETREATING = "retreating"
    """The guard moves the probe away from the body."""
    HOLDING = "holding"
    """The guard keeps the arm at rest until the cause is gone."""


@dataclass(frozen=True)
class GuardStatus(Immutable):
    """State of the guard, and the reason for its last intervention."""

    state: GuardState
    reason: str = ""
    """Reason for the last intervention as a sentence; empty if there was none."""
    since: float = 0.0
    """Time at which the state was entered, in s."""
    interventions: int = 0
    """Number of interventions so far."""
    remark: str = ""
    """Observations so far that needed no intervention; empty if there were none."""

    @property
    def stopped(self) -> bool:
        """True while the guard, and not the controller, commands the arm."""
        return self.state is not GuardState.MONITORING
