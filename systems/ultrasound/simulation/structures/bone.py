"""Bone: a bright surface with a full shadow, and echoes between it and the probe."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import Fraction, Positive, require
from sonoservo.systems.ultrasound.simulation.axes import frame_along
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Diffuse,
    Level,
    Repeated,
    Structure,
    Surfaces,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import Surface, parametric


@dataclass(kw_only=True)
class Bone(Structure):
    """A long bone, a rib or a pubic ramus: a cylinder with an elliptical cross-section.

    Parameters
    ----------
    start, end
        Ends of the axis in T, in m.
    width, thickness
        Horizontal and vertical axes of the ellipse, in m. A wide, thin ellipse is a flat bone.
    level_db, diffuse_db, shadow, reverberation_db
        See `SurfaceEcho`. Cortical bone reflects about -6 dB of the sound at normal incidence and
        soft tissue scatters -50 to -60 dB of it, so bone stands out by 45 to 50 dB.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("start", "end")

    kind: str = "bone"
    start: list[float] = field(default_factory=lambda: [0.0, -0.03, -0.05])
    end: list[float] = field(default_factory=lambda: [0.0, 0.03, -0.05])
    width: Positive = 0.012
    thickness: Positive = 0.008
    level_db: Level = 45.0
    diffuse_db: Diffuse = -20.0
    shadow: Fraction = 1.0
    reverberation_db: Repeated = -14.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.start != self.end, "end", self.end, "another point than start")

    @property
    def reach(self) -> float:
        """Half of the shorter axis, in m."""
        return min(self.width, self.thickness) / 2

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the bone's hull without its ends."""
        start, axis = np.array(self.start), np.subtract(self.end, self.start)
        _, across, up = frame_along(axis)

        def position(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
            angle = 2 * np.pi * v[:, np.newaxis]
            around = self.width * np.cos(angle) * across + self.thickness * np.sin(angle) * up
            return start + u[:, np.newaxis] * axis + around / 2

        perimeter = np.pi * max(self.width, self.thickness)
        hull = parametric(position, (float(np.linalg.norm(axis)), perimeter), spacing)
        return [(_outward(hull, start, axis), self.surface_echo(one_sided=True))]


def _outward(hull: Surface, start: NDArray[np.float64], axis: NDArray[np.float64]) -> Surface:
    """Return the hull with normals that point away from its axis."""
    share = (hull.points - start) @ axis / (axis @ axis)
    outward = np.einsum("ij,ij->i", hull.normals, hull.points - start - share[:, None] * axis)
    return Surface(hull.points, hull.normals * np.sign(outward)[:, None], hull.areas)
