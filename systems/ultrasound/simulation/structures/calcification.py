"""Calcifications: small and bright, with a shadow."""

from dataclasses import dataclass, field

import numpy as np

from sonoservo.systems.signals.requirements import Positive, require
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Structure,
    require_level,
    require_levels,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import (
    Surface,
    SurfaceEcho,
)


@dataclass(kw_only=True)
class Calcification(Structure):
    """A rough grain of calcium.

    Parameters
    ----------
    centre
        Centre of the grain in T, in m.
    radius
        Radius of the grain, in m.
    level_db
        Amplitude of the echo relative to the tissue's at the lens's focus, for a grain that fills
        the beam.
    shadow
        See `SurfaceEcho`.
    """

    kind: str = "calcification"
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.04])
    radius: Positive = 1.5e-3
    level_db: float = 34.0
    shadow: float = 0.9

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.radius <= 0.02, "radius", self.radius, "at most 0.02 m")
        require_level(level_db=self.level_db)
        require_levels(0.0, self.shadow)

    @property
    def reach(self) -> float:
        """Radius of the grain, in m."""
        return self.radius

    def surfaces(
        self, spacing: float, rng: np.random.Generator
    ) -> list[tuple[Surface, SurfaceEcho]]:
        """Return a sphere that scatters in all directions."""
        step = min(spacing / 1.5, self.radius / 3)
        count = int(np.ceil(4 * np.pi * (self.radius / step) ** 2))
        # A golden spiral spreads points evenly on a sphere.
        height = 1 - 2 * (np.arange(count) + 0.5) / count
        angle = np.pi * (1 + np.sqrt(5)) * np.arange(count)
        ring = np.sqrt(1 - height**2)
        normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=-1)
        area = 4 * np.pi * self.radius**2 / count
        sphere = Surface(self.centre + self.radius * normals, normals, np.full(count, area))
        echo = SurfaceEcho(
            level_db=self.level_db,
            diffuse_db=0.0,
            shadow=self.shadow,
            one_sided=True,
            specular=False,
        )
        return [(sphere, echo)]
