"""Volume on a Cartesian grid."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.sampling.interpolation import sample_flags, sample_grid
from sonoservo.systems.sampling.seen_hull import cut_level, darkest, seen_hull
from sonoservo.systems.signals.immutable import Immutable, read_only, seal
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL, SweepGeometry, SweepMotion

_MAX_SPACING = 0.02
"""Largest distance between voxels, in m; a larger one is given in mm."""


@dataclass(frozen=True, eq=False)
class Volume(Immutable):
    """Intensities on a Cartesian grid aligned with the probe frame P.

    Parameters
    ----------
    intensities
        (nx, ny, nz) array of echo amplitudes, log-compressed to 0 to 255, as uint8 or as finite
        float32 on the same scale. Element [i, j, k] lies at ``origin + spacing * (i, j, k)`` in P.
        Elements that were not seen are zero; those that were may be.
    origin
        (3,) position in P of element [0, 0, 0], in m.
    spacing
        (3,) distances between neighbouring elements along X, Y, Z, in m.
    X_WP
        Pose of the probe in the world, at ``time``.
    time
        Time of the middle of the acquisition, in s.
    motion
        Time and pose at which each frame was acquired. If it is unknown (None), the whole volume
        counts as acquired at ``time`` from ``X_WP``.
    decibels_per_level
        Decibels per unit of intensity.
    point_spread
        Widths of a point's echo by depth; None if unknown.
    mask
        (nx, ny, nz) flags of the elements that were seen, if whoever made the volume knows them;
        see `seen`.

    Raises
    ------
    ValueError
        If a shape is wrong, an axis has fewer than 2 elements, a spacing is not above zero or
        exceeds 20 mm, or a value is not finite.
    """

    intensities: NDArray[np.uint8] | NDArray[np.float32]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    X_WP: RigidTransform
    time: float
    motion: SweepMotion | None = None
    decibels_per_level: float = DECIBELS_PER_LEVEL
    point_spread: PointSpread | None = None
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        array = np.asarray(self.intensities)
        dtype = np.uint8 if array.dtype == np.uint8 else np.float32
        array = read_only(array, "intensities", (None, None, None), dtype)
        require(
            min(array.shape) >= 2, "intensities.shape", array.shape, "at least 2 along each axis"
        )
        object.__setattr__(self, "intensities", array)
        object.__setattr__(self, "origin", read_only(self.origin, "origin", (3,)))
        object.__setattr__(self, "spacing", read_only(self.spacing, "spacing", (3,)))
        require_positive(**{f"spacing[{axis}]": s for axis, s in enumerate(self.spacing)})
        for axis, spacing in enumerate(self.spacing):
            allowed = f"at most {_MAX_SPACING:g} m; lengths are in m, and 0.7 mm is 0.7e-3"
            require(spacing <= _MAX_SPACING, f"spacing[{axis}]", float(spacing), allowed)
        require(bool(np.isfinite(self.time)), "time", self.time, "finite")
        require_positive(decibels_per_level=self.decibels_per_level)
        if self.mask is not None:
            mask = read_only(self.mask, "mask", array.shape, np.bool_)
            object.__setattr__(self, "mask", mask)

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
    inside = np.empty(shape, bool)
    for number, each in enumerate(x):
        plane = np.concatenate([np.full((*rows.shape[:2], 1), each), rows], axis=-1)
        inside[number] = geometry.contains(plane)
    return seal(inside)
