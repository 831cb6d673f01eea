"""Where all that is random in a run comes from."""

from dataclasses import dataclass

import numpy as np

from sonoservo.diagrams.scenario import Scenario


@dataclass(frozen=True)
class Seeds:
    """One for each thing that is random, so that none depends on how the others draw."""

    tissue: int
    insertion: int
    noise: int
    wrist: int
    tracker: int


def draw_seeds(scenario: Scenario) -> Seeds:
    """Return the seeds that a scenario's own stands for."""
    return Seeds(*(int(each) for each in np.random.SeedSequence(scenario.seed).generate_state(5)))
