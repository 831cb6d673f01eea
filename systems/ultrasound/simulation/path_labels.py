"""Labels of cubes in which attenuation or speed of sound differ from those of plain tissue."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.ultrasound.simulation.anatomy.anatomy_grid import AnatomyGrid
from sonoservo.systems.ultrasound.simulation.axes import distance_to_segment
from sonoservo.systems.ultrasound.simulation.structures.structure import Tube
from sonoservo.systems.ultrasound.simulation.tissue import Tissue

_SPACING = 1e-3


class PathLabels(NamedTuple):
    """Labels of cubes, and the effects of each label on propagating sound."""

    labels: NDArray[np.uint8]
    """(nx, ny, nz) labels."""
    origin: NDArray[np.float64]
    """(3,) corner of the first cube in T, in m."""
    spacing: float
    loss_rate: NDArray[np.float64]
    """(labels,) two-way attenuations relative to the tissue's, in nepers per m."""
    delay_rate: NDArray[np.float64]
    """(labels,) path in m by which echoes appear deeper, per m of path."""


def path_labels(
    tissue: Tissue,
    grid: AnatomyGrid | None,
    tubes: list[Tube],
    sound_speed: float,
    frequency: float,
) -> PathLabels | None:
    """Label the cubes in which attenuation or speed differ; return None if there are none."""
    plain = tissue.attenuation
    properties = () if grid is None else grid.properties
    attenuations = [plain if p.attenuation is None else p.attenuation for p in properties]
    delays = [0.0 if p.sound_speed is None else sound_speed / p.sound_speed - 1 for p in properties]
    if grid is None:
        attenuations, delays = [plain], [0.0]
    fat = tissue.fat
    fatty = fat.thickness > 0 and fat.attenuation not in (None, plain)
    special = [tube for tube in tubes if tube.attenuation != plain]
    differ = any(a != plain for a in attenuations) or any(delays)
    if not (differ or fatty or special):
        return None
    size = np.array(tissue.size)
    if grid is None:
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for tube in special:
            low = np.minimum(low, tube.path.min(axis=0) - tube.radius)
            high = np.maximum(high, tube.path.max(axis=0) + tube.radius)
        if fatty:
            low = np.minimum(low, [-size[0] / 2, -size[1] / 2, -fat.thickness])
            high = np.maximum(high, [size[0] / 2, size[1] / 2, 0])
        low = np.maximum(low, [-size[0] / 2, -size[1] / 2, -size[2]])
        high = np.minimum(high, [size[0] / 2, size[1] / 2, 0])
        spacing = _SPACING
        labels = np.zeros(np.maximum(np.ceil((high - low) / spacing).astype(int), 1), np.uint8)
    else:
        low, spacing, labels = grid.origin, grid.spacing, grid.numbers.copy()
    for tube in special:
        for start, end in zip(tube.path[:-1], tube.path[1:], strict=True):
            _paint(labels, low, spacing, start, end, tube.radius, len(attenuations))
        attenuations.append(tube.attenuation)
        delays.append(0.0)
    if fatty and fat.attenuation is not None:
        heights = low[2] + (np.arange(labels.shape[2]) + 0.5) * spacing
        labels[:, :, heights > -fat.thickness] = len(attenuations)
        attenuations.append(fat.attenuation)
        delays.append(0.0)
    per_metre = 2 * 1e-4 * frequency * np.log(10) / 20
    return PathLabels(
        labels,
        low,
        spacing,
        per_metre * (np.array(attenuations) - plain),
        np.array(delays),
    )


def _paint(
    labels: NDArray[np.uint8],
    origin: NDArray[np.float64],
    spacing: float,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    radius: float,
    label: int,
) -> None:
    """Label the cubes whose centres lie in a straight piece of a tube."""
    low = np.floor((np.minimum(start, end) - radius - origin) / spacing).astype(int)
    high = np.ceil((np.maximum(start, end) + radius - origin) / spacing).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, labels.shape)
    if (high <= low).any():
        return
    part = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    indices = np.moveaxis(np.indices(tuple(high - low)), 0, -1) + low
    middles = origin + (indices + 0.5) * spacing
    labels[part][distance_to_segment(middles, start, end) < radius] = label
