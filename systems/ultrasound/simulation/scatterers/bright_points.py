"""Bright points that represent the tissue's inclusions and wires."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import rod_amplitudes
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Fibre, Tissue

_BALL_POINTS_PER_CELL = 8


def inclusion_points(
    tissue: Tissue, beam: Beam, reference: int
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Return the (n, 3) positions in T, in m, and (n,) complex amplitudes of all inclusions."""
    rng = np.random.default_rng([tissue.seed, 1])
    parts = [(np.zeros((0, 3)), np.zeros(0, complex))]
    # From a generator of its own, so that other inclusions stay as they are.
    drawn_balls = tissue.random_balls.draw(tissue.size, np.random.default_rng([tissue.seed, 5]))
    balls = tissue.balls + [ball for ball in drawn_balls if _is_inside(ball.centre, tissue)]
    parts += [_ball_points(ball, beam.resolution_cell[reference], rng) for ball in balls]
    drawn = tissue.random_fibres.draw(tissue.size, rng)
    middles = [np.add(fibre.start, fibre.end) / 2 for fibre in drawn]
    inside = [_is_inside(middle, tissue) for middle in middles]
    fibres = tissue.fibres + [each for each, there in zip(drawn, inside, strict=True) if there]
    parts += [_fibre_points(fibre, beam, reference, rng) for fibre in fibres]
    parts += [
        _fibre_points(
            Fibre(
                start=[*rod.start], end=[*rod.end], level_db=rod.level_db, diffuse_db=rod.diffuse_db
            ),
            beam,
            reference,
            rng,
        )
        for structure in tissue.structures
        for rod in structure.rods()
    ]
    points, amplitudes = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(amplitudes)


def _is_inside(middle: ArrayLike, tissue: Tissue) -> bool:
    """Return True if a random inclusion lies in the tissue, as it always does in a box."""
    return not tissue.surface.is_curved or bool(tissue.surface.contains(middle))


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
    fibre: Fibre,
    beam: Beam,
    reference: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    spacing, specular, diffuse = rod_amplitudes(fibre.level_db, fibre.diffuse_db, beam, reference)
    start, end = np.array(fibre.start), np.array(fibre.end)
    along = np.arange(0, 1, spacing / np.linalg.norm(end - start))[:, np.newaxis]
    phases = rng.uniform(0, 2 * np.pi, len(along))
    return start + along * (end - start), specular + diffuse * np.exp(1j * phases)
