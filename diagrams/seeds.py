"""Random seeds of the parts of a run, and the tissue that they draw."""

from dataclasses import dataclass, replace

import numpy as np

from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.ultrasound.simulation.tissue import Tissue, load_tissue


@dataclass(frozen=True)
class Seeds:
    """Independent random seeds of the parts of a run.

    `tissue`, `insertion`: seeds of the phantom's speckle, and of needle and hand; `noise`: seed of
    the scanner's noise; `station`: seed of the wrist sensor's noise, or of the tissue's shifts;
    `tracker`: seed of the random choices of tracker or estimator.
    """

    tissue: int
    insertion: int
    noise: int
    station: int
    tracker: int


def draw_seeds(scenario: Scenario) -> Seeds:
    """Return the seeds that follow from a scenario's own."""
    return Seeds(*(int(each) for each in np.random.SeedSequence(scenario.seed).generate_state(5)))


def make_tissue(scenario: Scenario, phantom: str, insertion: Insertion) -> Tissue:
    """Return a phantom's tissue with the layout and the speckle that a scenario's seed draws."""
    tissue = load_tissue(phantom).placed(insertion.entry, insertion.direction, scenario.seed)
    return replace(tissue, seed=draw_seeds(scenario).tissue)
