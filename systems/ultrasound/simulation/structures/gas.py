"""Gas: a bright, irregular surface with a dirty shadow."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    require,
)
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Structure,
    require_level,
    require_levels,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import (
    Surface,
    SurfaceEcho,
    parametric,
)


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
    size: list[float] = field(default_factory=lambda: [0.02, 0.02])
    roughness: NotNegative = 0.4e-3
    bump_length: Positive = 4e-3
    level_db: float = 44.0
    diffuse_db: float = -10.0
    shadow: float = 0.97
    ring_down_db: float = -34.0
    ring_down_length: Positive = 0.04

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.size) == 2 and min(self.size) > 0, "size", self.size, "two lengths in m")
        require(self.roughness <= 5e-3, "roughness", self.roughness, "at most 5e-3 m")
        require(self.ring_down_db <= 0, "ring_down_db", self.ring_down_db, "at most 0 dB")
        require_level(level_db=self.level_db)
        require_levels(self.diffuse_db, self.shadow)

    def surfaces(
        self, spacing: float, rng: np.random.Generator
    ) -> list[tuple[Surface, SurfaceEcho]]:
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
        echo = SurfaceEcho(
            level_db=self.level_db,
            diffuse_db=self.diffuse_db,
            shadow=self.shadow,
            one_sided=True,
            ring_down_db=self.ring_down_db,
            ring_down_length=self.ring_down_length,
        )
        return [(Surface(face.points[oval], face.normals[oval], face.areas[oval]), echo)]
