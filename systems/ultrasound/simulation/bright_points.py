"""Bright points that represent a needle and the tissue's inclusions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import NeedleEcho
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Fibre, Tissue

_WATER_SOUND_SPEED = 1480.0
_LONGEST_NEEDLE = 0.3
_BALL_POINTS_PER_CELL = 8


@dataclass(kw_only=True)
class NeedleEchoParameters:
    """Parameters of a steel needle's echo; levels are amplitudes at the lens's focus.

    Parameters
    ----------
    specular_db
        Level at normal incidence, relative to the tissue's root mean square.
    diffuse_db
        Level of the part that the rough surface scatters in all directions, relative to
        ``specular_db``.
    tip_db
        Level of the part that the bevel scatters in all directions, as if from one point, relative
        to the tissue's root mean square.
    bevel_deg
        Angle between the bevel's face and the axis. The shaft's own echo fades along the bevel.
    reverberation_db
        Level of each echo inside the needle, relative to the previous one.
    inner_diameter_ratio
        Ratio of inner to outer diameter, which sets the distance between those echoes.
    shadow
        Share of the amplitude that is lost behind a needle in the middle of the beam.
    """

    specular_db: float = 40.0
    diffuse_db: float = -20.0
    tip_db: float = 30.0
    bevel_deg: float = 20.0
    reverberation_db: float = -8.0
    inner_diameter_ratio: float = 0.66
    shadow: float = 0.45

    def __post_init__(self) -> None:
        require(
            self.reverberation_db <= -3, "reverberation_db", self.reverberation_db, "at most -3 dB"
        )
        require(0 < self.bevel_deg <= 90, "bevel_deg", self.bevel_deg, "above 0, at most 90 deg")
        for name in ("inner_diameter_ratio", "shadow"):
            value = getattr(self, name)
            require(0 <= value <= 1, name, value, "from 0 to 1")


def needle_echo(
    parameters: NeedleEchoParameters, beam: Beam, reference: int, rng: np.random.Generator
) -> tuple[NeedleEcho, NDArray[np.float64]]:
    """Return the amplitudes of a needle's points, and the phases due to its rough surface.

    Parameters
    ----------
    parameters
        Levels of the needle's echo.
    beam, reference
        Point spread function, and the sample at which the levels hold.
    rng
        Generator that draws the surface.
    """
    spacing, specular, diffuse = _rod(
        parameters.specular_db, parameters.diffuse_db, beam, reference
    )
    tip = 10 ** (parameters.tip_db / 20)
    phases = rng.uniform(0, 2 * np.pi, int(_LONGEST_NEEDLE / spacing))
    bevel = 2 / np.tan(np.deg2rad(parameters.bevel_deg))
    return NeedleEcho(spacing, specular, diffuse, tip, bevel, parameters.shadow), phases


def reverberations(
    parameters: NeedleEchoParameters, radius: float, sound_speed: float
) -> tuple[list[float], float]:
    """Return the levels of the echoes inside a water-filled needle, and their distance in m.

    The first echo is the front wall's; the series ends 40 dB below it.
    """
    ratio = 10 ** (parameters.reverberation_db / 20)
    count = 1 + int(-40 / parameters.reverberation_db)
    inner_diameter = 2 * radius * parameters.inner_diameter_ratio
    distance = inner_diameter * sound_speed / _WATER_SOUND_SPEED
    return [ratio**number for number in range(count)], distance


def inclusion_points(
    tissue: Tissue, beam: Beam, reference: int
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Return the (n, 3) positions in T, in m, and (n,) complex amplitudes of all inclusions."""
    rng = np.random.default_rng([tissue.seed, 1])
    parts = [(np.zeros((0, 3)), np.zeros(0, complex))]
    parts += [_ball_points(ball, beam.resolution_cell[reference], rng) for ball in tissue.balls]
    fibres = tissue.fibres + tissue.random_fibres.draw(tissue.size, rng)
    parts += [_fibre_points(fibre, beam, reference, rng) for fibre in fibres]
    points, amplitudes = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(amplitudes)


def _ball_points(
    ball: Ball, cell: float, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    cells = 4 / 3 * np.pi * ball.radius**3 / cell
    count = int(np.ceil(_BALL_POINTS_PER_CELL * max(cells / 2**1.5, 1)))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    offsets = ball.radius * np.cbrt(rng.random((count, 1))) * directions
    level = 10 ** (ball.level_db / 20) * np.sqrt(cells / count)
    return offsets + ball.centre, level * np.exp(2j * np.pi * rng.random(count))


def _fibre_points(
    fibre: Fibre, beam: Beam, reference: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    spacing, specular, diffuse = _rod(fibre.level_db, fibre.diffuse_db, beam, reference)
    start, end = np.array(fibre.start), np.array(fibre.end)
    along = np.arange(0, 1, spacing / np.linalg.norm(end - start))[:, np.newaxis]
    phases = rng.uniform(0, 2 * np.pi, len(along))
    return start + along * (end - start), specular + diffuse * np.exp(1j * phases)


def _rod(
    level_db: float, diffuse_db: float, beam: Beam, reference: int
) -> tuple[float, float, float]:
    """Return the spacing in m and the specular and diffuse amplitudes of a thin rod's points."""
    spacing = beam.wavelength / 8
    width = beam.lateral[reference]
    # The amplitudes of points in phase add up under the beam.
    length = np.sqrt(2 * np.pi) * width
    specular = 10 ** (level_db / 20) * spacing / length
    # The intensities of points with random phases add up.
    length = np.sqrt(np.pi) * width
    diffuse = 10 ** ((level_db + diffuse_db) / 20) * np.sqrt(spacing / length)
    return spacing, specular, diffuse
