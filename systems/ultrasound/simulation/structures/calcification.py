"""Calcifications: small and bright, with a shadow."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from sonoservo.systems.signals.requirements import Fraction
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Level,
    Structure,
    Surfaces,
    up_to,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import Surface


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
    radius: Annotated[float, up_to(0.02)] = 1.5e-3
    level_db: Level = 34.0
    shadow: Fraction = 0.9

    @property
    def reach(self) -> float:
        """Radius of the grain, in m."""
        return self.radius

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
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
        return [(sphere, self.surface_echo(diffuse_db=0.0, one_sided=True, specular=False))]
