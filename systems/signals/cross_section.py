"""Cross-sections of the needle in slices."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import Immutable, NotFound, Shape, Vector3

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CrossSection(Immutable):
    """A needle's cross-section in one slice. If there is none, a `NotFound` takes its place."""

    position: Vector3
    """Position of the needle's axis in W, in m."""

    X_WP: Annotated[Floats, Shape(4, 4)]
    """Pose of the probe in W. The slice is the plane Z = 0 of P."""

    time: float
    """Time of the slice, in s."""

    correlation: float
    """Correlation with the template, from 0 to 1."""

    centre: Annotated[Floats, Shape(2)]
    """x and y of the axis in P, in m."""

    template: Annotated[NDArray[np.float32], Shape(None, None, dtype=np.float32)]
    """Variance image around the axis, with which it is found in the next slice."""


@dataclass(frozen=True, eq=False)
class CrossSectionTrack(Immutable):
    """Cross-sections found so far, for the localizer of the next one."""

    found: CrossSection | NotFound = field(default_factory=lambda: NotFound("no slice yet"))
    """Cross-section in the newest slice, or the reason why there is none."""

    time: float = -np.inf
    """Time of the newest slice, in s."""

    last: CrossSection | None = None
    """Last cross-section found; None before the first one."""

    images: tuple[ImageSlice, ...] = ()
    """Slices seen before the first cross-section, oldest first."""
