"""Regions in which scatterers are stronger, weaker or fewer than in plain tissue, by block."""

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from sonoservo.systems.ultrasound.simulation.anatomy.anatomy_grid import AnatomyGrid
from sonoservo.systems.ultrasound.simulation.kernels.regions import NO_REGIONS, Regions
from sonoservo.systems.ultrasound.simulation.structures.structure import Tube
from sonoservo.systems.ultrasound.simulation.structures.vessel import distance_to_segment
from sonoservo.systems.ultrasound.simulation.tissue import Tissue


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
