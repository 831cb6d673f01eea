"""Anatomy on a grid of labels: scattering, sound, and surfaces between labels."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import affine_transform, find_objects, gaussian_filter

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import Bounded, Fraction, check_bounds, require, within
from sonoservo.systems.ultrasound.simulation.anatomy.label_map import LabelMap
from sonoservo.systems.ultrasound.simulation.structures.structure import Diffuse, Level, Repeated
from sonoservo.systems.ultrasound.simulation.structures.surface import Surface, SurfaceEcho

_LEAST_SLOPE = 0.02


def level_surface(
    field: NDArray[np.float32], origin: NDArray[np.float64], spacing: float
) -> Surface:
    """Extract the surface at which a field is 1/2, with normals towards smaller values.

    The (nx, ny, nz) samples begin at the (3,) origin; lengths are in m.
    """
    # Every cell between eight samples in which the field crosses 1/2 gives one piece. Within it,
    # the field is taken as linear: f0 + g . x, with x from 0 to 1. The area of its level set is the
    # derivative of the volume below the level (Scardovelli and Zaleski 2000),
    #
    #     A = |g| / (2 g1 g2 g3) sum over corners s of (-1)^|s| max(c - g . s, 0)^2
    #
    # with |g_i| for g_i and c the level above the lowest corner. The areas of a plane's pieces add
    # up to the plane's.
    inside = field > 0.5
    box = find_objects(inside.astype(np.uint8))
    if not box or box[0] is None:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    first = np.array([max(each.start - 2, 0) for each in box[0]])
    part = tuple(
        slice(low, min(each.stop + 2, size))
        for low, each, size in zip(first, box[0], field.shape, strict=True)
    )
    field, inside = field[part], inside[part]
    cells = np.argwhere(_crossed(inside))
    corners = np.array([field[tuple((cells + s).T)] for s in np.ndindex(2, 2, 2)], dtype=np.float64)
    signs = 2 * np.array(list(np.ndindex(2, 2, 2))) - 1
    slope = corners.T @ signs / 4
    middle = corners.mean(axis=0)
    steepness = np.maximum(np.linalg.norm(slope, axis=1), 1e-9)
    normals = -slope / steepness[:, np.newaxis]
    areas = spacing**2 * _section(np.abs(slope) / steepness[:, None], (0.5 - middle) / steepness)
    shift = np.clip((middle - 0.5) / steepness, -1, 1)[:, np.newaxis] * normals
    points = origin + spacing * (cells + first + 0.5 + shift)
    kept = areas > 0
    return Surface(points[kept], normals[kept], areas[kept])


def _crossed(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the cells whose corners are not all alike."""
    some, every = inside, inside
    for axis in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        some = some[tuple(low)] | some[tuple(high)]
        every = every[tuple(low)] & every[tuple(high)]
    return some & ~every


def _section(normal: NDArray[np.float64], offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the areas in which planes with (n, 3) unit normals >= 0 cut the unit cube.

    ``offset`` are the (n,) distances of the planes from the cube's centre along the normals.
    """
    g = np.maximum(normal, _LEAST_SLOPE)
    level = offset + g.sum(axis=1) / 2
    total = np.zeros(len(g))
    for corner in np.ndindex(2, 2, 2):
        total += (-1) ** sum(corner) * np.maximum(level - g @ np.array(corner), 0) ** 2
    return np.maximum(np.linalg.norm(g, axis=1) * total / (2 * g.prod(axis=1)), 0)


_SMOOTHING = 0.7
_MARGIN = 4
_MAX_CUBES = 30_000_000
_TOPS = {
    "S": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "I": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "A": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "P": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "L": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "R": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
}
"""Axes X, Y and Z of T in the patient's frame, by the side of the patient the probe is on."""


@dataclass(kw_only=True)
class LabelProperties(Bounded):
    """Acoustic properties of one label of a map.

    Parameters
    ----------
    label, name
        Number of the label in the map, and its name.
    level_db
        Mean echo intensity relative to that of plain tissue.
    density
        Density of scatterers relative to plain tissue. Fewer scatterers give coarser speckle (a K
        distribution with a smaller nu) at the same mean level.
    attenuation
        One-way attenuation, in dB/(cm MHz); None for plain tissue's.
    sound_speed
        Speed of sound, in m/s; None for plain tissue's.
    boundary_db
        Specular level of the label's surface (see `SurfaceEcho`); None for no surface.
    diffuse_db, shadow
        Diffuse level and shadow of the surface (see `SurfaceEcho`). A surface that blocks more than
        half of the sound reflects only on the side that faces the probe.
    reverberation_db
        Level of the reverberation between surface and probe (see `SurfaceEcho`).
    """

    label: Annotated[int, within(0, 65535)] = 0
    name: str = ""
    level_db: Annotated[float, within(-100, 40, " dB")] = 0.0
    density: Annotated[float, within(0.02, 1)] = 1.0
    attenuation: Annotated[float | None, within(0, 30, " dB/cm/MHz")] = None
    sound_speed: Annotated[float | None, within(300, 6000, " m/s")] = None
    boundary_db: Level | None = None
    diffuse_db: Diffuse = -14.0
    shadow: Fraction = 0.0
    reverberation_db: Repeated | None = None

    @property
    def echo(self) -> SurfaceEcho | None:
        """Return the reflection of the label's surface; None if it has no surface."""
        if self.boundary_db is None and self.shadow == 0:
            return None
        return SurfaceEcho(
            level_db=-100.0 if self.boundary_db is None else self.boundary_db,
            diffuse_db=self.diffuse_db,
            shadow=self.shadow,
            one_sided=self.shadow > 0.5,
            reverberation_db=self.reverberation_db,
        )


@dataclass(frozen=True, eq=False)
class AnatomyGrid(Immutable):
    """A label map in the tissue frame T, whose first cube begins at the (3,) origin, in m.

    ``numbers`` are (nx, ny, nz) uint8 indices of the cubes' ``properties``.
    """

    numbers: NDArray[np.uint8]
    origin: NDArray[np.float64]
    spacing: float
    properties: tuple[LabelProperties, ...]
    surfaces: tuple[tuple[Surface, SurfaceEcho], ...]

    @property
    def size(self) -> list[float]:
        """Extents along X, Y and Z of T, in m; T's origin is the middle of the top face."""
        return [float(n * self.spacing) for n in self.numbers.shape]


@dataclass(kw_only=True)
class AnatomyParameters:
    """Orientation and resampling of a label map, and the table of its labels.

    Parameters
    ----------
    top
        Side of the patient the probe is on, towards which Z of T points: A(nterior), P(osterior),
        L(eft), R(ight), S(uperior) or I(nferior).
    spacing
        Edge of the cubes to which the map is resampled, in m.
    surface_spacing
        Distance between the pieces of surfaces, in m.
    labels
        Entries for every label of the map except 0, which is plain tissue.
    """

    top: str = "A"
    spacing: Annotated[float, within(1e-4, 5e-3, " m")] = 0.6e-3
    surface_spacing: Annotated[float, within(1e-4, 5e-3, " m")] = 1.2e-3
    labels: list[LabelProperties] = field(default_factory=list)

    def __post_init__(self) -> None:
        require(self.top in _TOPS, "top", self.top, f"one of {', '.join(_TOPS)}")
        check_bounds(self)
        numbers = [each.label for each in self.labels]
        require(len(set(numbers)) == len(numbers), "labels", numbers, "different from each other")
        require(len(numbers) < 255, "labels", len(numbers), "at most 254 entries")


def anatomy_grid(label_map: LabelMap, parameters: AnatomyParameters) -> AnatomyGrid:
    """Resample a label map to cubes of the tissue frame, and extract the surfaces of its labels.

    The label of a cube is the one with the largest smoothed share of the voxels around it, so
    coarse or oblique voxels leave no visible steps. A ValueError names a label that the table
    lacks, or a map that is too large.
    """
    table = {each.label: each for each in parameters.labels}
    table.setdefault(0, LabelProperties(label=0, name="tissue"))
    present = np.flatnonzero(np.bincount(label_map.labels.ravel()))
    unknown = [int(label) for label in present if label not in table]
    require(
        not unknown,
        "labels",
        unknown,
        f"in the table of labels, which has {', '.join(map(str, sorted(table)))}",
    )
    properties = tuple(table[int(label)] for label in {0: 0} | dict.fromkeys(present))

    X_TV, extent = _pose_in_tissue(label_map, parameters.top)
    shape = np.maximum(np.floor(extent / parameters.spacing + 1e-6).astype(int), 2)
    require(
        int(np.prod(shape)) <= _MAX_CUBES,
        "spacing",
        parameters.spacing,
        f"so that there are at most {_MAX_CUBES:,} cubes; the map is {_in_mm(extent)} mm large",
    )
    require(float(extent.max()) <= 2, "anatomy", extent.tolist(), "at most 2 m large")
    size = shape * parameters.spacing
    origin = np.array([-size[0] / 2, -size[1] / 2, -size[2]])
    # From indices of cubes to those of voxels.
    cubes = np.eye(4)
    cubes[:3, :3] *= parameters.spacing
    cubes[:3, 3] = origin + parameters.spacing / 2
    to_voxel = np.linalg.inv(X_TV) @ cubes
    numbers = np.zeros(shape, np.uint8)
    best = np.zeros(shape, np.float32)
    plain = np.ones(shape, np.float32)
    boxes = find_objects(label_map.labels)
    surfaces: list[tuple[Surface, SurfaceEcho]] = []
    for number, each in enumerate(properties):
        if each.label == 0:
            continue
        first, share = _share(label_map, each.label, boxes[each.label - 1], to_voxel, shape)
        part = tuple(slice(low, low + n) for low, n in zip(first, share.shape, strict=True))
        plain[part] -= share
        here = share > best[part]
        numbers[part][here] = number
        best[part][here] = share[here]
        if each.echo is not None:
            middle = origin + parameters.spacing * (first + 0.5)
            stride = max(round(parameters.surface_spacing / parameters.spacing), 1)
            coarse = share[::stride, ::stride, ::stride]
            surface = level_surface(coarse, middle, stride * parameters.spacing)
            surfaces.append((surface, each.echo))
    numbers[plain > best] = 0
    return AnatomyGrid(numbers, origin, parameters.spacing, properties, tuple(surfaces))


def _share(
    label_map: LabelMap,
    label: int,
    box: tuple[slice, ...],
    to_voxel: NDArray[np.float64],
    shape: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the index of the first cube that a label reaches, and its smoothed shares of cubes."""
    labels = label_map.labels
    low = np.maximum([each.start - _MARGIN for each in box], 0)
    high = np.minimum([each.stop + _MARGIN for each in box], labels.shape)
    inside = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    smooth = gaussian_filter((labels[inside] == label).astype(np.float32), _SMOOTHING)
    ends = np.stack(np.meshgrid(*zip(low, high - 1, strict=True), indexing="ij"), axis=-1)
    inverse = np.linalg.inv(to_voxel)
    corners = ends.reshape(-1, 3) @ inverse[:3, :3].T + inverse[:3, 3]
    first = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, shape - 1)
    last = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 1, first + 1, shape)
    share = affine_transform(
        smooth,
        to_voxel[:3, :3],
        to_voxel[:3, :3] @ first + to_voxel[:3, 3] - low,
        output_shape=tuple(last - first),
        order=1,
        mode="nearest",
    )
    return first, share


def _pose_in_tissue(
    label_map: LabelMap, top: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (4, 4) transform from voxels to T, and the (3,) extents in T in m."""
    turn = np.eye(4)
    turn[:3, :3] = np.array(_TOPS[top])
    X = turn @ label_map.X_LV
    corners = _corners(label_map.labels.shape) @ X[:3, :3].T + X[:3, 3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    X[:3, 3] -= [*((low + high) / 2)[:2], high[2]]
    return X, high - low


def _in_mm(extent: NDArray[np.float64]) -> str:
    return " x ".join(f"{1e3 * each:.0f}" for each in extent)


def _corners(shape: Sequence[int]) -> NDArray[np.float64]:
    ends = [(-0.5, size - 0.5) for size in shape]
    return np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1).reshape(-1, 3)
