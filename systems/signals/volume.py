"""Volume on a Cartesian grid, swept or reconstructed; and the check of those before a tracker."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.sampling.interpolation import sample_flags, sample_grid
from sonoservo.systems.sampling.seen_hull import cut_level, darkest, seen_hull
from sonoservo.systems.sampling.workers import by_parts
from sonoservo.systems.signals.immutable import Immutable, Shape, Vector3, own, read_only, seal
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import Finite, Positive, require
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL, SweepGeometry, SweepMotion

_MAX_SPACING = 0.02
"""Largest distance between voxels, in m; a larger one is given in mm."""


@dataclass(frozen=True, eq=False)
class Volume(Immutable):
    """Intensities on a Cartesian grid aligned with the probe frame P."""

    intensities: NDArray[np.uint8] | NDArray[np.float32]
    """(nx, ny, nz) echo amplitudes, log-compressed to 0 to 255, as uint8 or as finite float32 on
    the same scale. Element [i, j, k] lies at ``origin + spacing * (i, j, k)`` in P. Elements that
    were not seen are zero; those that were may be."""

    origin: Vector3
    """Position in P of element [0, 0, 0], in m."""

    spacing: Vector3
    """Distances between neighbouring elements along X, Y, Z, in m, of at most 20 mm."""

    X_WP: RigidTransform
    """Pose of the probe in the world, at ``time``."""

    time: Finite
    """Time of the middle of the acquisition, in s."""

    motion: SweepMotion | None = None
    """Time and pose at which each frame was acquired. If it is unknown (None), the whole volume
    counts as acquired at ``time`` from ``X_WP``."""

    decibels_per_level: Positive = DECIBELS_PER_LEVEL
    """Decibels per unit of intensity."""

    point_spread: PointSpread | None = None
    """Widths of a point's echo by depth; None if unknown."""

    mask: Annotated[NDArray[np.bool_], Shape("x", "y", "z", dtype=np.bool_)] | None = None
    """Flags of the elements that were seen, if the volume's source knows them; see `seen`."""

    def __post_init__(self) -> None:
        pose = type(self.X_WP).__name__
        require(isinstance(self.X_WP, RigidTransform), "X_WP", pose, "a RigidTransform of a matrix")
        array = np.asarray(self.intensities)
        dtype = np.uint8 if array.dtype == np.uint8 else np.float32
        array = read_only(array, "intensities", (None, None, None), dtype)
        require(
            min(array.shape) >= 2, "intensities.shape", array.shape, "at least 2 along each axis"
        )
        if dtype == np.float32:
            for level in (float(array.min()), float(array.max())):
                require(0 <= level <= 255, "intensities", level, "log-compressed, from 0 to 255")
        object.__setattr__(self, "intensities", array)
        super().__post_init__()
        for axis, spacing in enumerate(self.spacing):
            allowed = f"above 0 and at most {_MAX_SPACING:g} m; lengths are in m, and 0.7 mm is "
            fits = 0 < spacing <= _MAX_SPACING
            require(fits, f"spacing[{axis}]", float(spacing), f"{allowed}0.7e-3")

    def _extents(self) -> dict[str, int]:
        return dict(zip("xyz", self.intensities.shape, strict=True))

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(nx, ny, nz) flags of what was seen: the ``mask``, the sector, or `seen_hull`."""
        if self.mask is not None:
            return self.mask
        if self.motion is None:
            return seal(seen_hull(self.intensities))
        grid = (tuple(self.origin.tolist()), tuple(self.spacing.tolist()), self.intensities.shape)
        return _in_sector(self.motion.geometry, *grid)

    def sees(self, p_P: ArrayLike) -> NDArray[np.bool_]:
        """Return flags of (..., 3) positions in P beside which an element was seen."""
        return sample_flags(self.seen, p_P, self.origin, self.spacing)

    def without_cut(self) -> "Volume":
        """Return the volume with what was cut off raised to its level (`cut_level`)."""
        if self.motion is not None or self.intensities.all():
            return self
        cut = cut_level(darkest(self.intensities), self.decibels_per_level)
        if cut == 0:
            return self
        dark = self.seen & (self.intensities == 0)
        grey: NDArray[Any] = np.where(dark, cut, self.intensities)
        grey = grey.astype(self.intensities.dtype)
        return replace(self, intensities=seal(grey), mask=self.seen)

    @property
    def upper(self) -> NDArray[np.float64]:
        """(3,) position in P of the last element, in m."""
        return self.origin + self.spacing * (np.array(self.intensities.shape) - 1)

    def position(self, index: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 3) positions in P, in m, of elements; fractional indices are allowed."""
        return self.origin + self.spacing * np.asarray(index)

    def index(self, p_P: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 3) fractional indices of positions in P, in m."""
        return np.asarray((np.asarray(p_P, dtype=float) - self.origin) / self.spacing)

    def sample(self, p_P: ArrayLike, outside: float | None = 0.0) -> NDArray[np.float32]:
        """Return (...) intensities at (..., 3) positions in P, by trilinear interpolation."""
        return sample_grid(self.intensities, p_P, self.origin, self.spacing, outside)

    def at_once(self) -> "Volume":
        """Return the same volume as if all of it had been acquired at ``time`` from ``X_WP``."""
        if self.motion is None:
            return self
        times = np.full_like(self.motion.times, self.time)
        poses = np.broadcast_to(self.X_WP.GetAsMatrix4(), self.motion.X_WP.shape)
        return replace(self, motion=replace(self.motion, times=times, X_WP=poses))

    def to_world(self, p_P: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (m, 3) positions in W and (m,) times at which positions in P were acquired."""
        if self.motion is not None:
            return self.motion.to_world(p_P)
        p_P = np.asarray(p_P, dtype=float)
        return self.X_WP.multiply(p_P.T).T.reshape(-1, 3), np.full(len(p_P), self.time)

    def to_probe(self, p_W: ArrayLike) -> NDArray[np.float64]:
        """Return the (m, 3) positions in P, in m, of positions in W, for the pose at ``time``."""
        return self.X_WP.inverse().multiply(np.asarray(p_W, dtype=float).T).T.reshape(-1, 3)


@dataclass(frozen=True)
class VolumeCheck(Immutable):
    """Numbers of volumes accepted and refused so far, before a tracker."""

    accepted: int = 0
    refused: int = 0
    reason: str = ""
    """Reason why the newest volume was refused; empty if it was accepted."""


@lru_cache(maxsize=4)
def _in_sector(
    geometry: SweepGeometry,
    origin: tuple[float, ...],
    spacing: tuple[float, ...],
    shape: tuple[int, ...],
) -> NDArray[np.bool_]:
    """Return the flags of a grid's elements in a sector; a run's volumes share them."""
    x, y, z = (o + s * np.arange(n) for o, s, n in zip(origin, spacing, shape, strict=True))
    rows = np.stack(np.broadcast_arrays(y[:, np.newaxis], z), axis=-1)

    def flags(part: slice) -> list[NDArray[np.bool_]]:
        planes = (np.insert(rows, 0, each, axis=-1) for each in x[part])
        return [geometry.contains(plane) for plane in planes]

    return seal(np.array(list(chain(*by_parts(flags, len(x))))))


class Acquired(Protocol):
    """A picture that knows when and from where it was acquired, such as a `Volume`."""

    @property
    def X_WP(self) -> RigidTransform:
        """Pose of the probe at the picture's time."""

    @property
    def motion(self) -> SweepMotion | None:
        """Time and pose of each frame; None if unknown."""


def acquired_from(volume: Acquired, p_W: ArrayLike) -> NDArray[np.float64]:
    """Return (m, 3) positions in P, in m, at which a volume shows positions in W.

    It inverts `SweepMotion.to_world` by two steps of a fixed-point iteration: the probe moves
    little while a volume is acquired.
    """
    p_W = np.asarray(p_W, dtype=float)
    p_P: NDArray[np.float64] = volume.X_WP.inverse().multiply(p_W.T).T.reshape(-1, 3)
    if volume.motion is not None:
        R_PW = volume.X_WP.rotation().matrix().T
        for _ in range(2):
            p_P = p_P + (p_W - volume.motion.to_world(p_P)[0]) @ R_PW.T
    return p_P


@dataclass(frozen=True, eq=False, kw_only=True)
class ReconstructedVolume(Volume):
    """Volume with voxels at the positions seen by the frames, in a frame P that does not move."""

    frames: NDArray[np.float32]
    """(nx, ny, nz) number of the frame in which each voxel was seen, fractional between two frames.
    It is NaN for voxels that no frame has passed, and in gaps that are too wide."""

    frame_times: Annotated[NDArray[np.float64], Shape("f")]
    """Times of the frames in s."""

    frame_poses: Annotated[NDArray[np.float64], Shape("f", 4, 4)]
    """Poses of the frames in W, in m: X along the rows of pixels, Y along the depth."""

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = self.intensities.shape
        require(self.frames.shape == shape, "frames", self.frames.shape, f"of shape {shape}")
        object.__setattr__(self, "frames", own(self.frames))

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(nx, ny, nz) flags of the voxels that frames have passed."""
        return seal(~self.holes)

    @property
    def holes(self) -> NDArray[np.bool_]:
        """(nx, ny, nz) flags of the voxels without a frame."""
        return np.isnan(self.frames)

    def frame_at(self, p_P: ArrayLike) -> NDArray[np.float64]:
        """Return the (m,) fractional numbers of the frames that saw positions in P, or NaN."""
        last = np.array(self.frames.shape) - 1
        index = np.round(np.reshape(self.index(p_P), (-1, 3)))
        inside = ((index >= 0) & (index <= last)).all(axis=1)
        i, j, k = np.clip(index, 0, last).astype(int).T
        return np.where(inside, self.frames[i, j, k], np.nan)

    def to_world(self, p_P: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions in W, in m, and times, in s, at which positions in P were acquired."""
        p_P = np.reshape(np.asarray(p_P, dtype=float), (-1, 3))
        frame = self.frame_at(p_P)
        known = np.nan_to_num(frame)
        times = np.interp(known, np.arange(len(self.frame_times)), self.frame_times)
        return (
            self.X_WP.multiply(p_P.T).T.reshape(-1, 3),
            np.where(np.isnan(frame), self.time, times),
        )
