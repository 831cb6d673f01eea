"""A refracting layer of fat on top of the tissue, with a lower speed of sound."""

from dataclasses import dataclass
from typing import Annotated

from sonoservo.systems.signals.requirements import (
    NotNegative,
    check_bounds,
    require,
    require_not_negative,
    within,
)


@dataclass(kw_only=True)
class FatLayer:
    """Fat from the top of the tissue down to a level face. The probe lies directly on it.

    Parameters
    ----------
    thickness
        Thickness of the layer, in m; 0 for no fat.
    sound_speed
        Speed of sound, in m/s; 1430 to 1480 in fat (Duck 1990).
    level_db
        Level of the layer's scatterers relative to the tissue's.
    attenuation
        One-way attenuation, in dB/(cm MHz); None for the tissue's.
    """

    thickness: NotNegative = 0.0
    sound_speed: float = 1450.0
    level_db: Annotated[float, within(-100, 40, " dB")] = -4.0
    attenuation: float | None = None

    def __post_init__(self) -> None:
        check_bounds(self)
        require(self.thickness <= 0.2, "thickness", self.thickness, "at most 0.2 m")
        allowed = 1300 <= self.sound_speed <= 1700
        require(allowed, "sound_speed", self.sound_speed, "from 1300 to 1700 m/s")
        if self.attenuation is not None:
            require_not_negative(attenuation=self.attenuation)
            require(self.attenuation <= 30, "attenuation", self.attenuation, "at most 30 dB/cm/MHz")
