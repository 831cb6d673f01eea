"""Scatterers other than plain tissue: regions with other statistics, and bright points."""

import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.anatomy.anatomy_grid import AnatomyGrid
from sonoservo.systems.ultrasound.simulation.axes import distance_to_segment
from sonoservo.systems.ultrasound.simulation.kernels.regions import NO_REGIONS, Regions
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import rod_amplitudes
from sonoservo.systems.ultrasound.simulation.structures.structure import Tube
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
    # Points a third of a wavelength apart reflect sound like a line at every angle.
    parts += [
        _fibre_points(
            Fibre(
                start=[*rod.start], end=[*rod.end], level_db=rod.level_db, diffuse_db=rod.diffuse_db
            ),
            beam,
            reference,
            rng,
            3,
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
    points_per_wavelength: int = 8,
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    spacing, specular, diffuse = rod_amplitudes(
        fibre.level_db, fibre.diffuse_db, beam, reference, points_per_wavelength
    )
    start, end = np.array(fibre.start), np.array(fibre.end)
    along = np.arange(0, 1, spacing / np.linalg.norm(end - start))[:, np.newaxis]
    phases = rng.uniform(0, 2 * np.pi, len(along))
    return start + along * (end - start), specular + diffuse * np.exp(1j * phases)


def scatterer_regions(
    tissue: Tissue, grid: AnatomyGrid | None, tubes: list[Tube], block_size: float
) -> Regions:
    """Prepare lumens, labels and fat for the scatterers' kernel, by blocks."""
    fat = tissue.fat
    if grid is None and not tubes and (fat.thickness == 0 or fat.level_db == 0):
        return NO_REGIONS
    size = np.array(tissue.size)
    low = np.array([-size[0] / 2, -size[1] / 2, -size[2]])
    first = np.floor(low / block_size).astype(np.int64)
    count = np.ceil((low + size) / block_size).astype(np.int64) - first
    content = np.full(np.maximum(count, 1), -1, np.int32)
    if grid is not None:
        content[_mixed_blocks(grid, first, count, block_size)] = 0
    if fat.thickness > 0 and fat.level_db != 0:
        bottoms = (first[2] + np.arange(count[2]) + 1) * block_size
        content[:, :, bottoms > -fat.thickness] = 0
    ends = [(number, *pair) for number, tube in enumerate(tubes) for pair in _pairs(tube.path)]
    members: list[list[int]] = [[]]
    blocks = first + np.moveaxis(np.indices(content.shape), 0, -1)
    middles = (blocks + 0.5).astype(np.float64) * block_size
    for segment, (number, start, end) in enumerate(ends):
        tube = tubes[number]
        reach = tube.radius * (1 + tube.pulsation) + np.sqrt(3) / 2 * block_size
        near = distance_to_segment(middles, start, end) < reach
        for block in np.argwhere(near):
            place = tuple(block)
            if content[place] <= 0:
                content[place] = len(members)
                members.append([])
            members[content[place]].append(segment)
    properties = () if grid is None else grid.properties
    shares = np.array([each.density for each in properties] or [1.0])
    levels = np.array([each.level_db for each in properties] or [0.0])
    return Regions(
        first_block=first,
        content=content,
        starts=np.concatenate([[0], np.cumsum([len(m) for m in members])]).astype(np.int32),
        members=np.array([segment for m in members for segment in m], dtype=np.int32),
        ends=np.array([[start, end] for _, start, end in ends]).reshape(-1, 2, 3),
        tubes=np.array([number for number, _, _ in ends], dtype=np.int32),
        tube_amplitudes=np.array([10 ** (t.level_db / 20) for t in tubes], dtype=np.float32),
        labels=np.zeros((1, 1, 1), np.uint8) if grid is None else grid.numbers.copy(),
        origin=np.full(3, 1e3) if grid is None else grid.origin.copy(),
        per_metre=1.0 if grid is None else 1 / grid.spacing,
        amplitudes=(10 ** (levels / 20) / np.sqrt(shares)).astype(np.float32),
        shares=shares.astype(np.float32),
        fat_thickness=float(fat.thickness),
        fat_amplitude=float(10 ** (fat.level_db / 20)),
        quantiles=ndtri(np.random.default_rng(0).permutation(np.arange(256) + 0.5) / 256),
    )


def _pairs(
    path: NDArray[np.float64],
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    return list(itertools.pairwise(path))


def _mixed_blocks(
    grid: AnatomyGrid, first: NDArray[np.int64], count: NDArray[np.int64], block_size: float
) -> NDArray[np.bool_]:
    """Return a (bx, by, bz) mask of the blocks with a label other than plain tissue."""
    special = np.array([each.level_db != 0 or each.density != 1 for each in grid.properties])
    mixed = special[grid.numbers]
    for axis in range(3):
        # A cube counts for all blocks that it overlaps.
        edges = (first[axis] + np.arange(count[axis] + 1)) * block_size
        cubes = (edges - grid.origin[axis]) / grid.spacing
        starts = np.clip(np.floor(cubes[:-1]).astype(int), 0, mixed.shape[axis] - 1)
        stops = np.clip(np.ceil(cubes[1:]).astype(int), starts + 1, mixed.shape[axis])
        mixed = np.stack(
            [
                mixed.take(range(start, stop), axis=axis).any(axis=axis)
                for start, stop in zip(starts, stops, strict=True)
            ],
            axis=axis,
        )
    return mixed
