"""Base class of the structures in the tissue, and their placement beside a needle."""

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.random_streams import HELD_OUT
from sonoservo.systems.signals.requirements import (
    Bound,
    Bounded,
    check_bounds,
    require,
    within,
)
from sonoservo.systems.ultrasound.simulation.axes import frame_along
from sonoservo.systems.ultrasound.simulation.structures.surface import (
    Surface,
    SurfaceEcho,
)

Level: TypeAlias = Annotated[float, within(-100, 80, " dB")]
"""Level relative to the tissue, in dB."""

Diffuse: TypeAlias = Annotated[float, within(-100, 20, " dB")]
"""Level of what a surface scatters in all directions, relative to its echo, in dB."""

Repeated: TypeAlias = Annotated[float, Bound("at most -3 dB", lambda level: level <= -3)]
"""Level of an echo relative to the one that it repeats, in dB."""

Extents: TypeAlias = Annotated[
    list[float], Bound("two lengths in m", lambda size: len(size) == 2 and min(size) > 0)
]
"""Two extents above 0, in m."""

Surfaces: TypeAlias = list[tuple[Surface, SurfaceEcho]]


def up_to(high: float) -> Bound:
    """Return the bound of a length above 0 that has a greatest value, in m."""
    return Bound(f"above 0 and at most {high:g} m", lambda value: 0 < value <= high)


class Rod(NamedTuple):
    """A thin, straight reflector: ends in T in m, and levels as in `Fibre`."""

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    level_db: float
    diffuse_db: float


class Tube(NamedTuple):
    """A lumen with few scatterers.

    The radius at time t is radius (1 + pulsation sin(2 pi rate t)).
    """

    path: NDArray[np.float64]
    """(m, 3) points of the axis in T, in m."""
    radius: float
    level_db: float
    """Level of the scatterers relative to the tissue's."""
    attenuation: float
    """One-way attenuation, in dB/(cm MHz)."""
    pulsation: float
    rate: float
    """Rate of the pulsation, in Hz."""
    flow: float = 0.0
    """Speed of the flow, in m/s."""


_TURNED, _ALONG, _LEVEL, _DEPTH = 20.0, 0.01, 0.01, 0.003
"""Greatest differences between layouts: angle in deg about the needle, distance in m along it, and,
for structures that do not lie beside it, distances in m along X and Y, and along Z, of T."""


@dataclass(kw_only=True)
class BesideNeedle(Bounded):
    """A position beside the path of the needle.

    Parameters
    ----------
    distance
        Distance from the needle's axis to the structure's nearest surface, in m.
    along
        Depth along the needle from its entry, in m.
    angle_deg
        Angle about the needle's axis: 0 is level with the needle, to its left as seen along it; 90
        is above it.
    """

    distance: Annotated[float, within(0, 0.2, " m")] = 3e-3
    along: Annotated[float, within(0, 0.5, " m")] = 0.04
    angle_deg: float = -90.0

    def drawn(self, seed: int, rng: np.random.Generator) -> "BesideNeedle":
        """Return the position in the layout of a seed; the distance stays."""
        angle = self.angle_deg + rng.uniform(-_TURNED, _TURNED)
        along = max(self.along + rng.uniform(-_ALONG, _ALONG), 0.0)
        mirrored = seed in HELD_OUT
        return replace(self, angle_deg=180 - angle if mirrored else angle, along=along)

    def resolve(
        self, entry: ArrayLike, direction: ArrayLike, reach: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the (3,) centre in T, in m, of a structure with its surface ``reach`` m away."""
        along, across, up = frame_along(np.asarray(direction, dtype=float))
        angle = np.deg2rad(self.angle_deg)
        aside = np.cos(angle) * across + np.sin(angle) * up
        return np.asarray(entry) + self.along * along + (self.distance + reach) * aside


@dataclass(kw_only=True)
class Structure:
    """A structure in the tissue that reflects, or that is darker or brighter than the tissue.

    Parameters
    ----------
    beside_needle
        Position beside the needle's path to which the centre is moved; None leaves the structure in
        place.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("centre",)
    """Fields that hold a point in T, or a list of points."""

    beside_needle: BesideNeedle | None = None

    def __post_init__(self) -> None:
        check_bounds(self)
        for name in self.POINTS:
            value = np.asarray(getattr(self, name), dtype=float)
            allowed = value.shape[-1:] == (3,) and bool((np.abs(value) <= 2).all())
            require(allowed, name, getattr(self, name), "three coordinates in m")

    @property
    def middle(self) -> NDArray[np.float64]:
        """Centre of the structure in T, (3,), in m."""
        return np.mean([np.atleast_2d(getattr(self, n)).mean(axis=0) for n in self.POINTS], axis=0)

    @property
    def reach(self) -> float:
        """Distance from the centre to the nearest surface, in m."""
        return 0.0

    def moved(self, offset: ArrayLike) -> Self:
        """Return the structure moved by a (3,) offset in T, in m."""
        changes: dict[str, Any] = {
            name: (np.asarray(getattr(self, name), dtype=float) + offset).tolist()
            for name in self.POINTS
        }
        return replace(self, beside_needle=None, **changes)

    def drawn(self, seed: int, rng: np.random.Generator) -> Self:
        """Return the structure at its place in the layout of a seed."""
        if self.beside_needle is not None:
            return replace(self, beside_needle=self.beside_needle.drawn(seed, rng))
        return self.moved(rng.uniform(-1, 1, 3) * (_LEVEL, _LEVEL, _DEPTH))

    def placed(self, entry: ArrayLike, direction: ArrayLike) -> Self:
        """Return the structure at the position of `beside_needle`; see `BesideNeedle.resolve`."""
        if self.beside_needle is None:
            return self
        place = self.beside_needle.resolve(entry, direction, self.reach)
        return self.moved(place - self.middle)

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the surfaces in pieces of at most ``spacing`` m; ``rng`` draws irregularities."""
        return []

    def surface_echo(self, **others: Any) -> SurfaceEcho:
        """Return the echo of the surface, from the fields of the same names and others."""
        names = {each.name for each in fields(SurfaceEcho)} & vars(self).keys()
        return SurfaceEcho(**{name: getattr(self, name) for name in names} | others)

    def rods(self) -> list[Rod]:
        """Return the thin reflectors."""
        return []

    def tubes(self) -> list[Tube]:
        """Return the lumens."""
        return []
