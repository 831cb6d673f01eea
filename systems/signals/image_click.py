"""A person's click on an image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only


@dataclass(frozen=True, eq=False)
class ImageClick(Immutable):
    """A person's click on a slice. Until there is one, a `NotFound` takes its place.

    Parameters
    ----------
    position
        (2,) x and y in P of the point clicked at, in m.
    """

    position: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", read_only(self.position, "position", (2,)))
