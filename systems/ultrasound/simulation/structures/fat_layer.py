"""A refracting layer of fat on top of the tissue, with a lower speed of sound."""

from dataclasses import dataclass
from typing import Annotated

from sonoservo.systems.signals.requirements import Bounded, within


@dataclass(kw_only=True)
class FatLayer(Bounded):
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

    thickness: Annotated[float, within(0, 0.2, " m")] = 0.0
    sound_speed: Annotated[float, within(1300, 1700, " m/s")] = 1450.0
    level_db: Annotated[float, within(-100, 40, " dB")] = -4.0
    attenuation: Annotated[float | None, within(0, 30, " dB/cm/MHz")] = None
