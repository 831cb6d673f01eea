"""One image of the tissue on a Cartesian grid, and a person's click on it."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.sampling.interpolation import sample_grid
from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.requirements import Finite, Positive, require, require_positive
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL


@dataclass(frozen=True, eq=False)
class ImageSlice(Immutable):
    """Intensities on a Cartesian grid in the plane Z = 0 of the probe frame P."""

    intensities: Annotated[NDArray[np.uint8], Shape(None, None, dtype=np.uint8)]
    """(nx, ny) log-compressed echo amplitudes. Element [i, j] lies at
    ``origin + spacing * (i, j)``; y is depth. Elements outside the sector are zero."""

    origin: Annotated[NDArray[np.float64], Shape(2)]
    """x and y in P of element [0, 0], in m."""

    spacing: Annotated[NDArray[np.float64], Shape(2)]
    """Distances between neighbouring elements, in m."""

    X_WP: RigidTransform
    """Pose of the probe in the world, at ``time``."""

    time: Finite
    """Time of the acquisition, in s."""

    apex: float = -np.inf
    """y in P, in m, of the point on x = 0 above the face from which the beams diverge; -inf if they
    are parallel."""

    decibels_per_level: Positive = DECIBELS_PER_LEVEL
    """Decibels per unit of intensity."""

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.intensities.shape
        require(min(shape) >= 3, "intensities.shape", shape, "at least 3 along each axis")
        require_positive(**{f"spacing[{axis}]": s for axis, s in enumerate(self.spacing)})

    def position(self, index: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 2) x and y in P, in m, of elements; fractional indices are allowed."""
        return self.origin + self.spacing * np.asarray(index)

    def index(self, p_P: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 2) fractional indices at x and y in P, in m."""
        return (np.asarray(p_P) - self.origin) / self.spacing

    def sample(self, p_P: ArrayLike, outside: float | None = 0.0) -> NDArray[np.float32]:
        """Return (...) intensities at (..., 2) x and y in P in m, by bilinear interpolation."""
        return sample_grid(self.intensities, p_P, self.origin, self.spacing, outside)

    def beam_direction(self, p_P: ArrayLike) -> NDArray[np.float64]:
        """Return the (2,) unit vector along the beam through x and y in P, away from the probe."""
        x, y = np.asarray(p_P, dtype=float)
        if not np.isfinite(self.apex):
            return np.array([0.0, 1.0])
        along = np.array([x, y - self.apex])
        return along / np.linalg.norm(along)

    def to_world(self, p_P: ArrayLike) -> NDArray[np.float64]:
        """Return the (3,) position in W, in m, of x and y in P."""
        x, y = np.asarray(p_P, dtype=float)
        p_W: NDArray[np.float64] = self.X_WP.multiply(np.array([x, y, 0.0]))
        return p_W


@dataclass(frozen=True, eq=False)
class ImageClick(Immutable):
    """A person's click on a slice. Until there is one, a `NotFound` takes its place."""

    position: Annotated[NDArray[np.float64], Shape(2)]
    """x and y in P of the point clicked at, in m."""
