"""Settings of a simulated scanner: needle, gel, air and noise."""

from dataclasses import dataclass, field

from sonoservo.systems.signals.requirements import require_not_negative
from sonoservo.systems.ultrasound.simulation.air_pockets import AirPocketParameters
from sonoservo.systems.ultrasound.simulation.needle_echo import NeedleEchoParameters


@dataclass(kw_only=True)
class ScannerParameters:
    """Parameters of the needle's echo, the gel, the air in it and the electronic noise.

    Parameters
    ----------
    needle
        Parameters of the needle's echo.
    gel_thickness
        Widest gap between face and tissue that the gel bridges, along a line, in m.
    air_pockets
        Air pockets under the face, behind which nothing is seen.
    noise_db
        Electronic noise at the face, relative to the tissue's root mean square. It grows with depth
        by the attenuation that the time-gain compensation undoes.
    """

    needle: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)
    gel_thickness: float = 3e-3
    air_pockets: AirPocketParameters = field(default_factory=AirPocketParameters)
    noise_db: float = -55.0

    def __post_init__(self) -> None:
        require_not_negative(gel_thickness=self.gel_thickness)
