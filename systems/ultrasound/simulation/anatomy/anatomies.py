"""Kinds of anatomy: a label map from a file, and a synthetic liver."""

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import require
from sonoservo.systems.ultrasound.simulation.anatomy.anatomy_grid import (
    AnatomyGrid,
    AnatomyParameters,
    LabelProperties,
    anatomy_grid,
)
from sonoservo.systems.ultrasound.simulation.anatomy.label_map import LabelMap, read_label_map
from sonoservo.systems.ultrasound.simulation.axes import distance_to_segment

LIVER_LABELS = (
    LabelProperties(label=1, name="abdominal wall", level_db=4.0, attenuation=0.6, density=0.5),
    LabelProperties(label=2, name="vein", level_db=-35.0, attenuation=0.18, boundary_db=18.0),
    LabelProperties(
        label=3, name="gallbladder", level_db=-38.0, attenuation=0.05, boundary_db=26.0
    ),
    LabelProperties(label=4, name="nodule", level_db=-7.0, attenuation=0.6, density=0.4),
    LabelProperties(
        label=5,
        name="rib",
        level_db=-20.0,
        boundary_db=45.0,
        diffuse_db=-20.0,
        shadow=1.0,
        reverberation_db=-14.0,
    ),
)
"""Tissues of the synthetic liver, relative to its parenchyma."""


@dataclass(kw_only=True)
class LabelMapAnatomy(AnatomyParameters):
    """Anatomy from a label map in a file.

    Parameters
    ----------
    file
        Path of the NRRD or NIfTI file.
    """

    kind: str = "label_map"
    file: str = ""

    def grid(self) -> AnatomyGrid:
        """Read the file and return its labels in T."""
        require(bool(self.file), "file", self.file, "a path to NRRD or NIfTI")
        path = Path(self.file)
        changed = path.stat().st_mtime if path.is_file() else 0.0
        return _file_grid(str(path), changed, yaml.safe_dump(_plain(self)))


@dataclass(kw_only=True)
class LiverAnatomy(AnatomyParameters):
    """A synthetic liver below the abdominal wall, with veins, gallbladder, nodule and a rib.

    Parameters
    ----------
    seed
        Random seed of the veins' course.
    """

    kind: str = "liver"
    seed: int = 0
    labels: list[LabelProperties] = field(default_factory=lambda: list(LIVER_LABELS))

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")

    def grid(self) -> AnatomyGrid:
        """Make the liver and return its labels in T."""
        return _liver_grid(self.seed, yaml.safe_dump(_plain(self)))


def liver_label_map(seed: int = 0) -> LabelMap:
    """Return a synthetic liver, 160 x 80 x 120 mm, in voxels of 1 mm, with veins drawn by the seed.

    The labels are those of `LIVER_LABELS`, and 0 is parenchyma. The abdominal wall is anterior.
    """
    rng = np.random.default_rng([seed, 7])
    shape, step = (160, 80, 120), 1e-3
    x, y, z = (
        (np.arange(size) + 0.5) * step - offset
        for size, offset in zip(shape, (0.08, 0.0, 0.06), strict=True)
    )
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    labels = np.zeros(shape, np.uint16)
    for start, end, radius in _veins(rng):
        low = np.minimum(start, end) - radius
        high = np.maximum(start, end) + radius
        box = tuple(
            slice(*np.searchsorted(axis, [a, b]))
            for axis, a, b in zip((x, y, z), low, high, strict=True)
        )
        labels[box][distance_to_segment(points[box], start, end) < radius] = 2
    for label, centre, half in (
        (3, (0.045, 0.050, 0.012), (0.014, 0.010, 0.020)),
        (4, (-0.028, 0.046, -0.010), (0.009, 0.008, 0.009)),
    ):
        labels[(((points - centre) / half) ** 2).sum(axis=-1) < 1] = label
    wall = 0.011 + 0.0015 * np.sin(60 * points[..., 0]) * np.cos(45 * points[..., 2])
    labels[points[..., 1] < wall] = 1
    rib = ((points[..., :2] - [0.062, 0.016]) / [0.007, 0.004]) ** 2
    labels[rib.sum(axis=-1) < 1] = 5
    X_LV = np.diag([step, step, step, 1.0])
    X_LV[:3, 3] = [x[0], y[0], z[0]]
    return LabelMap(labels, X_LV)


def _veins(
    rng: np.random.Generator,
) -> list[tuple[NDArray[np.float64], NDArray[np.float64], float]]:
    """Return the segments of the hepatic veins, which branch from the point where they leave."""
    segments = []
    root = np.array([0.0, 0.060, 0.055])
    open_ends = [(root, np.array([heading, -0.12, -1.0]), 0.0042) for heading in (-0.75, 0.0, 0.7)]
    while open_ends:
        start, heading, radius = open_ends.pop()
        heading = heading + 0.2 * rng.normal(size=3) * [1, 0.6, 1]
        heading /= np.linalg.norm(heading)
        end = start + heading * rng.uniform(0.018, 0.028)
        if not (abs(end[0]) < 0.075 and 0.016 < end[1] < 0.078 and abs(end[2]) < 0.058):
            continue
        segments.append((start, end, radius))
        if radius > 0.0012:
            open_ends.append((end, heading, 0.88 * radius))
        if radius > 0.0022:
            aside = heading + 0.8 * rng.normal(size=3) * [1, 0.8, 0.5]
            open_ends.append((end, aside, 0.7 * radius))
    return segments


def _plain(parameters: AnatomyParameters) -> dict[str, object]:
    labels = [dict(vars(each)) for each in parameters.labels]
    plain = {name: getattr(parameters, name) for name in ("top", "spacing", "surface_spacing")}
    return {**plain, "labels": labels}


def _parameters(text: str) -> AnatomyParameters:
    plain = yaml.safe_load(text)
    labels = [LabelProperties(**each) for each in plain.pop("labels")]
    return AnatomyParameters(labels=labels, **plain)


@lru_cache(maxsize=2)
def _file_grid(path: str, changed: float, parameters: str) -> AnatomyGrid:
    return anatomy_grid(read_label_map(path), _parameters(parameters))


@lru_cache(maxsize=2)
def _liver_grid(seed: int, parameters: str) -> AnatomyGrid:
    return anatomy_grid(liver_label_map(seed), _parameters(parameters))
