"""Settings of a simulated scanner: needle, gel, air, noise and errors."""

from dataclasses import dataclass, field

from sonoservo.systems.signals.requirements import require_not_negative
from sonoservo.systems.ultrasound.simulation.air_pockets import AirPocketParameters
from sonoservo.systems.ultrasound.simulation.errors.clock import ClockParameters
from sonoservo.systems.ultrasound.simulation.errors.connection import ConnectionParameters
from sonoservo.systems.ultrasound.simulation.errors.motor import MotorParameters
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters


@dataclass(kw_only=True)
class ScannerParameters:
    """Parameters of the needle's echo, the gel, the air in it, the electronic noise and errors.

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
    motor
        Errors of the motor that sweeps the array.
    clock
        Scanner's clock, relative to that of arm and program.
    connection
        Losses and delays between the scanner and the program that takes its sweeps.
    """

    needle: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)
    gel_thickness: float = 3e-3
    air_pockets: AirPocketParameters = field(default_factory=AirPocketParameters)
    noise_db: float = -55.0
    motor: MotorParameters = field(default_factory=MotorParameters)
    clock: ClockParameters = field(default_factory=ClockParameters)
    connection: ConnectionParameters = field(default_factory=ConnectionParameters)

    def __post_init__(self) -> None:
        require_not_negative(gel_thickness=self.gel_thickness)
