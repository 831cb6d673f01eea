"""Cross-section of the needle in one slice."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CrossSection(Immutable):
    """A needle's cross-section in one slice. If there is none, a `NotFound` takes its place.

    Parameters
    ----------
    position
        (3,) position of the needle's axis in W, in m.
    X_WP
        (4, 4) pose of the probe in W. The slice is the plane Z = 0 of P.
    time
        Time of the slice, in s.
    correlation
        Correlation with the template, from 0 to 1.
    centre
        (2,) x and y of the axis in P, in m.
    template
        (w, h) variance image around the axis, with which it is found in the next slice.
    """

    position: Floats
    X_WP: Floats
    time: float
    correlation: float
    centre: Floats
    template: NDArray[np.float32]

    def __post_init__(self) -> None:
        for name, shape in (("position", (3,)), ("X_WP", (4, 4)), ("centre", (2,))):
            object.__setattr__(self, name, read_only(getattr(self, name), name, shape))
        template = read_only(self.template, "template", (None, None), np.float32)
        object.__setattr__(self, "template", template)
