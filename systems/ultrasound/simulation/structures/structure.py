"""The face that all structures in the tissue share, and their placement beside a needle."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.requirements import require, require_not_negative
from sonoservo.systems.ultrasound.simulation.axes import frame_along
from sonoservo.systems.ultrasound.simulation.structures.surface import (
    Surface,
    SurfaceEcho,
)


class Rod(NamedTuple):
    """A thin, straight reflector: ends in T in m, and levels as `Fibre` has them."""

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    level_db: float
    diffuse_db: float


class Tube(NamedTuple):
    """A lumen with few scatterers.

    The radius at time t is radius (1 + pulsation sin(2 pi rate t)).
    """

    path: NDArray[np.float64]
    """(m, 3) points of its axis in T, in m."""
    radius: float
    level_db: float
    """Of its scatterers, over the tissue's."""
    attenuation: float
    """One way, in dB/(cm MHz)."""
    pulsation: float
    rate: float
    """In Hz."""


@dataclass(kw_only=True)
class BesideNeedle:
    """A place beside the way of the needle.

    Parameters
    ----------
    distance
        From the needle's axis to the structure's nearest surface, in m.
    along
        Depth along the needle from its entry, in m.
    angle_deg
        About the needle's axis: 0 is level with it, on its left as seen along it; 90 is above it.
    """

    distance: float = 3e-3
    along: float = 0.04
    angle_deg: float = -90.0

    def __post_init__(self) -> None:
        require_not_negative(distance=self.distance, along=self.along)
        require(self.distance <= 0.2, "distance", self.distance, "at most 0.2 m")
        require(self.along <= 0.5, "along", self.along, "at most 0.5 m")

    def resolve(
        self, entry: ArrayLike, direction: ArrayLike, reach: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the place in T, (3,) in m, of the middle of a structure.

        Parameters
        ----------
        entry, direction
            (3,) where the needle enters, in m, and the direction of its axis, in T.
        reach
            Distance from the structure's middle to its surface, in m.
        """
        along, across, up = frame_along(np.asarray(direction, dtype=float))
        angle = np.deg2rad(self.angle_deg)
        aside = np.cos(angle) * across + np.sin(angle) * up
        return np.asarray(entry) + self.along * along + (self.distance + reach) * aside


@dataclass(kw_only=True)
class Structure:
    """Something in the tissue that reflects, or that is darker or brighter than it.

    Parameters
    ----------
    beside_needle
        Moves the structure so that its middle lies beside the needle's way; None leaves it.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("centre",)
    """Fields that hold a point in T, or a list of points."""

    beside_needle: BesideNeedle | None = None

    def __post_init__(self) -> None:
        for name in self.POINTS:
            value = np.asarray(getattr(self, name), dtype=float)
            allowed = value.shape[-1:] == (3,) and bool((np.abs(value) <= 2).all())
            require(allowed, name, getattr(self, name), "three coordinates in m")

    @property
    def middle(self) -> NDArray[np.float64]:
        """(3,) middle in T, in m."""
        return np.mean([np.atleast_2d(getattr(self, n)).mean(axis=0) for n in self.POINTS], axis=0)

    @property
    def reach(self) -> float:
        """Distance from the middle to the nearest surface, in m."""
        return 0.0

    def moved(self, offset: ArrayLike) -> Self:
        """Return the structure, moved by (3,) m in T."""
        changes: dict[str, Any] = {
            name: (np.asarray(getattr(self, name), dtype=float) + offset).tolist()
            for name in self.POINTS
        }
        return replace(self, beside_needle=None, **changes)

    def placed(self, entry: ArrayLike, direction: ArrayLike) -> Self:
        """Return the structure where `beside_needle` wants it; see `BesideNeedle.resolve`."""
        if self.beside_needle is None:
            return self
        place = self.beside_needle.resolve(entry, direction, self.reach)
        return self.moved(place - self.middle)

    def surfaces(
        self, spacing: float, rng: np.random.Generator
    ) -> list[tuple[Surface, SurfaceEcho]]:
        """Surfaces in pieces of at most ``spacing`` m; ``rng`` draws what is irregular."""
        return []

    def rods(self) -> list[Rod]:
        """Thin reflectors."""
        return []

    def tubes(self) -> list[Tube]:
        """Lumens."""
        return []


def require_levels(diffuse_db: float, shadow: float) -> None:
    """Raise ValueError unless the levels of a surface are in range."""
    require(-100 <= diffuse_db <= 20, "diffuse_db", diffuse_db, "from -100 to 20 dB")
    require(0 <= shadow <= 1, "shadow", shadow, "from 0 to 1")


def require_level(**levels: float) -> None:
    """Raise ValueError unless levels over the tissue are in range."""
    for name, value in levels.items():
        require(-100 <= value <= 80, name, value, "from -100 to 80 dB")
