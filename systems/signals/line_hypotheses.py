"""Lines of a volume that might be needles, with the probability that each is one."""

from dataclasses import dataclass, fields, replace
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
    """Log odds that a line is a needle, by its looks alone, averaged over the volumes that judged
    it."""

    looked: Annotated[Floats, Shape("n")]
    """Numbers of these volumes."""

    numbers: Annotated[Floats, Shape("n")]
    """Numbers by which the lines are known from volume to volume."""

    def __bool__(self) -> bool:
        return len(self.numbers) > 0

    def best(self, count: int) -> "LineHypotheses":
        """Return the most probable needles among the lines, the first one first."""
        rows = np.argsort(-self.probabilities, kind="stable")[:count]
        names = (each.name for each in fields(self) if each.name != "time")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


@dataclass(frozen=True, eq=False)
class LinesExplanation(Immutable):
    """The lines most like a needle, and what the volumes so far showed along the first of them."""

    lines: LineHypotheses
    """Most probable lines, the first one first."""

    times: Annotated[Floats, Shape("v")]
    """Times of the volumes that are remembered, in s."""

    a: Annotated[Floats, Shape("b")]
    """Abscissae along the first line in m, from its outer end towards its tip."""

    contrasts: Annotated[NDArray[np.float32], Shape("v", "b", dtype=np.float32)]
    """Contrasts along it, in dB."""

    seen: Annotated[NDArray[np.bool_], Shape("v", "b", dtype=np.bool_)]
    """Flags of those that the volumes show; the others are 0."""
