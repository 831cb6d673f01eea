"""Sheets of fascia: thin, bright, specular layers."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import Fraction, NotNegative, Positive, within
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Diffuse,
    Extents,
    Level,
    Structure,
    Surfaces,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import parametric


@dataclass(kw_only=True)
class Fascia(Structure):
    """A rectangular, wavy sheet.

    Parameters
    ----------
    centre
        Centre of the sheet in T, in m.
    size
        Extents in m, along X and Y of T before the sheet is tilted.
    azimuth_deg, dip_deg
        Direction in which the sheet falls, from +X_T towards +Y_T, and angle by which it falls.
    wave_height, wave_length
        Amplitude and length of the waves, in m.
    level_db, diffuse_db, shadow
        See `SurfaceEcho`.
    """

    kind: str = "fascia"
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.03])
    size: Extents = field(default_factory=lambda: [0.06, 0.04])
    azimuth_deg: float = 0.0
    dip_deg: Annotated[float, within(-90, 90, " deg")] = 0.0
    wave_height: NotNegative = 0.2e-3
    wave_length: Positive = 0.02
    level_db: Level = 28.0
    diffuse_db: Diffuse = -12.0
    shadow: Fraction = 0.05

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the sheet, whose waves have random phases."""
        phase = rng.uniform(0, 2 * np.pi, 2)
        R = turned(self.azimuth_deg, self.dip_deg)

        def position(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
            x, y = (u - 0.5) * self.size[0], (v - 0.5) * self.size[1]
            rate = 2 * np.pi / self.wave_length
            height = np.sin(rate * x + phase[0]) + np.sin(rate * y + phase[1])
            flat = np.stack([x, y, self.wave_height / 2 * height], axis=-1)
            return self.centre + flat @ R.T

        sheet = parametric(position, (self.size[0], self.size[1]), spacing)
        return [(sheet, self.surface_echo())]


def turned(azimuth_deg: float, dip_deg: float) -> NDArray[np.float64]:
    """Return the rotation that makes a level sheet fall by ``dip_deg`` towards ``azimuth_deg``."""
    (ca, sa), (cd, sd) = ((np.cos(a), np.sin(a)) for a in np.deg2rad([azimuth_deg, dip_deg]))
    about_z = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    about_y = np.array([[cd, 0, sd], [0, 1, 0], [-sd, 0, cd]])
    return about_z @ about_y @ about_z.T
