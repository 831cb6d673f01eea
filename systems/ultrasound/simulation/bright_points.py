"""What bright points a needle and the tissue's inclusions consist of."""

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
    """How a steel needle echoes. Levels are amplitudes, where the lens focuses.

    Parameters
    ----------
    specular_db
        At normal incidence, over the tissue's root mean square.
    diffuse_db
        Of what a rough surface scatters in all directions, relative to ``specular_db``.
    tip_db
        Of what the bevel scatters in all directions, as if from one point, over the tissue's root
        mean square.
    bevel_deg
        Between the bevel's face and the axis. Along the bevel the shaft's own echo fades.
    reverberation_db
        Of each echo inside the needle, relative to the one before.
    inner_diameter_ratio
        Inner over outer diameter; sets the distance between those echoes.
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
    """Amplitudes of a needle's points, and the phases that its rough surface gives them.

    Parameters
    ----------
    parameters
        Levels.
    beam, reference
        Point spread function, and the sample where the levels hold.
    rng
        Draws the surface.
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
    """Levels of the echoes from within a water-filled needle, and the distance between them in m.

    The first is the front wall's; they end 40 dB below it.
    """
    ratio = 10 ** (parameters.reverberation_db / 20)
    count = 1 + int(-40 / parameters.reverberation_db)
    inner_diameter = 2 * radius * parameters.inner_diameter_ratio
    distance = inner_diameter * sound_speed / _WATER_SOUND_SPEED
    return [ratio**number for number in range(count)], distance


def inclusion_points(
    tissue: Tissue, beam: Beam, reference: int
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Positions in T, (n, 3) in m, and complex amplitudes, (n,), of all inclusions."""
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
    """Spacing in m, specular and diffuse amplitude of the points of a thin rod."""
    spacing = beam.wavelength / 8
    width = beam.lateral[reference]
    # In phase, the points under the beam add up.
    length = np.sqrt(2 * np.pi) * width
    specular = 10 ** (level_db / 20) * spacing / length
    # Out of phase, their intensities do.
    length = np.sqrt(np.pi) * width
    diffuse = 10 ** ((level_db + diffuse_db) / 20) * np.sqrt(spacing / length)
    return spacing, specular, diffuse
