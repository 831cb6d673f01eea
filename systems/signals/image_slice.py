"""One image of the tissue on a Cartesian grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.sampling.interpolation import sample_grid
from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL


@dataclass(frozen=True, eq=False)
class ImageSlice(Immutable):
    """Intensities on a Cartesian grid in the plane Z = 0 of the probe frame P.

    Parameters
    ----------
    intensities
        (nx, ny) uint8 log-compressed echo amplitudes. Element [i, j] lies at
        ``origin + spacing * (i, j)``; y is depth. Elements outside the sector are zero.
    origin
        (2,) x and y in P of element [0, 0], in m.
    spacing
        (2,) distances between neighbouring elements, in m.
    X_WP
        Pose of the probe in the world, at ``time``.
    time
        Time of the acquisition, in s.
    apex
        y in P, in m, of the point on x = 0 above the face from which the beams diverge; -inf if
        they are parallel.
    decibels_per_level
        Decibels per unit of intensity.

    Raises
    ------
    ValueError
        If a shape is wrong, a spacing is not above zero or a value is not finite.
    """

    intensities: NDArray[np.uint8]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    X_WP: RigidTransform
    time: float
    apex: float = -np.inf
    decibels_per_level: float = DECIBELS_PER_LEVEL

    def __post_init__(self) -> None:
        array = read_only(self.intensities, "intensities", (None, None), np.uint8)
        require(
            min(array.shape) >= 3, "intensities.shape", array.shape, "at least 3 along each axis"
        )
        object.__setattr__(self, "intensities", array)
        object.__setattr__(self, "origin", read_only(self.origin, "origin", (2,)))
        object.__setattr__(self, "spacing", read_only(self.spacing, "spacing", (2,)))
        require_positive(**{f"spacing[{axis}]": s for axis, s in enumerate(self.spacing)})
        require(bool(np.isfinite(self.time)), "time", self.time, "finite")
        require_positive(decibels_per_level=self.decibels_per_level)

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
