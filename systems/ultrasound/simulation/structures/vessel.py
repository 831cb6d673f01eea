"""Blood vessels: a dark, pulsating lumen between bright walls."""

import itertools
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import Fraction, NotNegative, Positive, require, within
from sonoservo.systems.ultrasound.simulation.axes import frame_along
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Diffuse,
    Level,
    Structure,
    Surfaces,
    Tube,
    up_to,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import Surface, parametric


@dataclass(kw_only=True)
class Vessel(Structure):
    """A vessel along a polyline.

    Parameters
    ----------
    path
        Points of the axis in T, in m.
    radius
        Mean inner radius, in m.
    lumen_db
        Level of the blood relative to the tissue.
    level_db, diffuse_db, shadow
        Levels and shadow of the wall; see `SurfaceEcho`.
    pulsation, heart_rate
        Amplitude of the radius relative to its mean (0.05 in a carotid artery, 0 in a vein), and
        its frequency in Hz.
    flow_speed
        Mean speed of the blood, in m/s; it decorrelates the lumen's speckle. 0 for none.
    attenuation
        One-way attenuation of the blood, in dB/(cm MHz). It is below that of tissue, so the tissue
        behind the vessel is brighter.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("path",)

    kind: str = "vessel"
    path: list[list[float]] = field(
        default_factory=lambda: [[-0.03, 0.0, -0.045], [0.03, 0.0, -0.045]]
    )
    radius: Annotated[float, up_to(0.05)] = 3e-3
    lumen_db: Level = -35.0
    level_db: Level = 36.0
    diffuse_db: Diffuse = -16.0
    shadow: Fraction = 0.0
    pulsation: Annotated[float, within(0, 0.5)] = 0.05
    heart_rate: Positive = 1.2
    attenuation: NotNegative = 0.18
    flow_speed: Annotated[float, within(0, 2, " m/s")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.path) >= 2, "path", self.path, "at least two points")
        steps = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        require(bool((steps > 1e-6).all()), "path", self.path, "points apart from each other")

    @property
    def reach(self) -> float:
        """Mean inner radius of the vessel, in m."""
        return self.radius

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the wall of each straight piece."""
        walls = []
        ends = np.array(self.path)
        for start, end in itertools.pairwise(ends):
            wall = _wall(start, end - start, self.radius, spacing)
            # Where two pieces meet, the part inside the other piece is not wall.
            outside = np.ones(len(wall.points), bool)
            for other, stop in itertools.pairwise(ends):
                if other is not start and not np.array_equal(other, start):
                    distance = distance_to_segment(wall.points, other, stop)
                    outside &= distance > 0.98 * self.radius
            walls.append(Surface(wall.points[outside], wall.normals[outside], wall.areas[outside]))
        return [(wall, self.surface_echo()) for wall in walls]

    def tubes(self) -> list[Tube]:
        """Return the lumen."""
        return [
            Tube(
                np.array(self.path),
                self.radius,
                self.lumen_db,
                self.attenuation,
                self.pulsation,
                self.heart_rate,
                self.flow_speed,
            )
        ]


def distance_to_segment(
    points: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distances in m of (..., 3) points from a straight segment."""
    axis = end - start
    share = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(points - start - share[..., np.newaxis] * axis, axis=-1)


def _wall(
    start: NDArray[np.float64], axis: NDArray[np.float64], radius: float, spacing: float
) -> Surface:
    _, across, up = frame_along(axis)

    def position(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        angle = -2 * np.pi * v[:, np.newaxis]
        around = radius * (np.cos(angle) * across + np.sin(angle) * up)
        return start + u[:, np.newaxis] * axis + around

    lengths = (float(np.linalg.norm(axis)), 2 * np.pi * radius)
    return parametric(position, lengths, spacing)
