"""Random seeds of the parts of a run."""

from dataclasses import dataclass

import numpy as np

from sonoservo.diagrams.scenario import Scenario


@dataclass(frozen=True)
class Seeds:
    """Independent random seeds of the parts of a run.

    Parameters
    ----------
    tissue, insertion
        Seeds of the phantom's speckle, and of needle and hand.
    noise
        Seed of the scanner's noise.
    station
        Seed of the wrist sensor's noise, or of the tissue's shifts.
    tracker
        Seed of the random choices of tracker or estimator.
    """

    tissue: int
    insertion: int
    noise: int
    station: int
    tracker: int


def draw_seeds(scenario: Scenario) -> Seeds:
    """Return the seeds that follow from a scenario's own."""
    return Seeds(*(int(each) for each in np.random.SeedSequence(scenario.seed).generate_state(5)))
