"""Gas: a bright, irregular surface with a dirty shadow."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from sonoservo.systems.signals.requirements import Bound, Fraction, Positive, within
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Diffuse,
    Extents,
    Level,
    Structure,
    Surfaces,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import Surface, parametric


@dataclass(kw_only=True)
class Gas(Structure):
    """The upper face of gas in bowel, lung or an abscess.

    Parameters
    ----------
    centre, size
        Centre in T and extents along X and Y of T, in m.
    roughness, bump_length
        Standard deviation of the surface's height and distance between its bumps, in m.
    level_db, diffuse_db, shadow
        See `SurfaceEcho`.
    ring_down_db, ring_down_length
        Ring-down, which makes the shadow dirty; see `SurfaceEcho`.
    """

    kind: str = "gas"
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.05])
    size: Extents = field(default_factory=lambda: [0.02, 0.02])
    roughness: Annotated[float, within(0, 5e-3, " m")] = 0.4e-3
    bump_length: Positive = 4e-3
    level_db: Level = 44.0
    diffuse_db: Diffuse = -10.0
    shadow: Fraction = 0.97
    ring_down_db: Annotated[float, Bound("at most 0 dB", lambda level: level <= 0)] = -34.0
    ring_down_length: Positive = 0.04

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the upper face."""
        counts = [min(int(np.ceil(size / self.bump_length)) + 4, 200) for size in self.size]
        heights = self.roughness * rng.normal(size=counts)
        bumps = RectBivariateSpline(*(np.linspace(0, 1, n) for n in counts), heights)

        def position(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
            x, y = (u - 0.5) * self.size[0], (v - 0.5) * self.size[1]
            return self.centre + np.stack([x, y, bumps(u, v, grid=False)], axis=-1)

        face = parametric(position, (self.size[0], self.size[1]), spacing)
        # The patch is oval, so that no straight edge is visible.
        offsets = (face.points - self.centre)[:, :2] / np.array(self.size)
        oval = (offsets**2).sum(axis=1) <= 0.25
        shown = Surface(face.points[oval], face.normals[oval], face.areas[oval])
        return [(shown, self.surface_echo(one_sided=True))]
