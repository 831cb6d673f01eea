"""Settings of a simulated scanner: needle, gel, air, noise and errors."""

from dataclasses import dataclass, field
from typing import Annotated, TypeAlias

from sonoservo.systems.signals.requirements import Bounded, NotNegative, Positive, within
from sonoservo.systems.ultrasound.simulation.air_pockets import AirPocketParameters
from sonoservo.systems.ultrasound.simulation.errors import (
    ClockParameters,
    ConnectionParameters,
    MotorParameters,
    Share,
)
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters

Decibels: TypeAlias = Annotated[float, within(-300, 20, " dB")]


@dataclass(kw_only=True)
class ScannerParameters(Bounded):
    """Parameters of the needle's echo, gel and air, noise, clutter, slow change and errors.

    Parameters
    ----------
    needle
        Parameters of the needle's echo.
    track_db
        Level of the track that a withdrawn straight needle of gauge 18 leaves, relative to the
        tissue's root mean square.
    gel_thickness
        Widest gap between face and tissue that the gel bridges, along a line, in m.
    air_pockets
        Air pockets under the face, behind which nothing is seen.
    noise_db
        Electronic noise at the face, relative to the tissue's root mean square. It grows with depth
        by the attenuation that the time-gain compensation undoes. At -50 dB and 0.5 dB/(cm MHz), it
        reaches the tissue's level 15 cm deep at 3.3 MHz and 7 cm deep at 7.5 MHz.
    gain_error_db
        Standard deviation of the gain compensation's error at each of eight sliders, in dB.
    clutter_db, clutter_length
        Level at the face of the haze that reverberation near the probe leaves, relative to the
        tissue's root mean square, and depth in m over which its amplitude falls to 1/e. It moves
        with the probe.
    decorrelation, decorrelation_time
        Share e of the tissue's intensity that changes while nothing moves, and its time tau in s.
        Echoes at times that differ by t have the correlation 1 - e (1 - cos(t / tau)).
    motor
        Errors of the motor that sweeps the array.
    clock
        Scanner's clock, relative to that of arm and program.
    connection
        Losses and delays between the scanner and the program that takes its sweeps.
    """

    needle: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)
    track_db: Decibels = -6.0
    gel_thickness: NotNegative = 3e-3
    air_pockets: AirPocketParameters = field(default_factory=AirPocketParameters)
    noise_db: Decibels = -50.0
    gain_error_db: Annotated[float, within(0, 20, " dB")] = 1.5
    clutter_db: Decibels = -20.0
    clutter_length: Positive = 0.04
    decorrelation: Share = 0.02
    decorrelation_time: Positive = 5.0
    motor: MotorParameters = field(default_factory=MotorParameters)
    clock: ClockParameters = field(default_factory=ClockParameters)
    connection: ConnectionParameters = field(default_factory=ConnectionParameters)
