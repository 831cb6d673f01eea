"""Cross-sections found so far, for the localizer of the next one."""

from dataclasses import dataclass, field

import numpy as np

from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import Immutable, NotFound


@dataclass(frozen=True, eq=False)
class CrossSectionTrack(Immutable):
    """Track of a needle's cross-sections so far.

    Parameters
    ----------
    found
        Cross-section in the newest slice, or the reason why there is none.
    time
        Time of the newest slice, in s.
    last
        Last cross-section found; None before the first one.
    images
        Slices seen before the first cross-section, oldest first.
    """

    found: CrossSection | NotFound = field(default_factory=lambda: NotFound("no slice yet"))
    time: float = -np.inf
    last: CrossSection | None = None
    images: tuple[ImageSlice, ...] = ()
