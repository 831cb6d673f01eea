"""Lines of a volume that might be needles, with the probability that each is one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only

LINE_CLASSES = ("needle", "resting", "riding", "appeared", "nothing")
"""What a line may be: a needle, whose far end advances along it; something at rest in the tissue;
something that rides along with the probe; something that appeared at once; or only speckle."""


@dataclass(frozen=True, eq=False)
class LineHypotheses(Immutable):
    """Lines that are followed through the volumes; falsy if there is none.

    Parameters
    ----------
    time
        Time of the newest volume, in s.
    ends
        (n, 2, 3) ends of the lines in W where that volume shows them, in m; a needle's tip last.
    probabilities
        (n,) probabilities that a line is a needle, by its motion and its looks.
    classes
        (n, 5) probabilities of the `LINE_CLASSES`, by the motion alone.
    looks
        (n,) log odds that a line is a needle, by its looks alone, averaged over the volumes that
        were looked at.
    looked
        (n,) numbers of these volumes.
    numbers
        (n,) numbers by which the lines are known from volume to volume.
    """

    time: float
    ends: NDArray[np.float64]
    probabilities: NDArray[np.float64]
    classes: NDArray[np.float64]
    looks: NDArray[np.float64]
    looked: NDArray[np.float64]
    numbers: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.numbers)
        for name, shape in (
            ("ends", (n, 2, 3)),
            ("probabilities", (n,)),
            ("classes", (n, len(LINE_CLASSES))),
            ("looks", (n,)),
            ("looked", (n,)),
            ("numbers", (n,)),
        ):
            object.__setattr__(self, name, read_only(getattr(self, name), name, shape))

    def __bool__(self) -> bool:
        return len(self.numbers) > 0
