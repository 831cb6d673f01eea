"""Seeds of the random parts of a run."""

from dataclasses import dataclass

import numpy as np

from sonoservo.diagrams.scenario import Scenario


@dataclass(frozen=True)
class Seeds:
    """One seed for each random part of a run, so that none depends on how the others draw.

    Parameters
    ----------
    tissue, insertion
        Speckle of the phantom; needle and hand.
    noise
        Noise of the scanner.
    station
        Noise of the wrist sensor, or the shifts of the tissue.
    tracker
        Random choices of tracker or estimator.
    """

    tissue: int
    insertion: int
    noise: int
    station: int
    tracker: int


def draw_seeds(scenario: Scenario) -> Seeds:
    """Return the seeds that follow from a scenario's own."""
    return Seeds(*(int(each) for each in np.random.SeedSequence(scenario.seed).generate_state(5)))
