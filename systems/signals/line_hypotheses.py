"""Lines of a volume that might be needles, with the probability that each is one."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, Shape

Floats = NDArray[np.float64]

LINE_CLASSES = ("needle", "resting", "riding", "appeared", "nothing")
"""What a line may be: a needle, whose far end advances along it; something at rest in the tissue;
something that rides along with the probe; something that appeared at once; or only speckle."""


@dataclass(frozen=True, eq=False)
class LineHypotheses(Immutable):
    """Lines that are followed through the volumes; falsy if there is none."""

    time: float
    """Time of the newest volume, in s."""

    ends: Annotated[Floats, Shape("n", 2, 3)]
    """Ends of the lines in W where that volume shows them, in m; a needle's tip last."""

    probabilities: Annotated[Floats, Shape("n")]
    """Probabilities that a line is a needle, by its motion and its looks."""

    classes: Annotated[Floats, Shape("n", len(LINE_CLASSES))]
    """Probabilities of the `LINE_CLASSES`, by the motion alone."""

    looks: Annotated[Floats, Shape("n")]
    """Log odds that a line is a needle, by its looks alone, averaged over the volumes that were
    looked at."""

    looked: Annotated[Floats, Shape("n")]
    """Numbers of these volumes."""

    numbers: Annotated[Floats, Shape("n")]
    """Numbers by which the lines are known from volume to volume."""

    def __bool__(self) -> bool:
        return len(self.numbers) > 0
