"""From received images to volumes on one grid in the probe's frame."""

from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.files.volume_file import check_grid, require_voxels
from sonoservo.systems.live.connection.items import ImageItem
from sonoservo.systems.live.image_matcher import PosedImage
from sonoservo.systems.recording.file_grid import FileGrid, make_file_grid
from sonoservo.systems.recording.grey_levels import GreyLevels, void_flags
from sonoservo.systems.signals.immutable import NotFound, seal
from sonoservo.systems.signals.requirements import require_within
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL, DYNAMIC_RANGE_DB
from sonoservo.systems.signals.volume import Volume

_RIGHT_ANGLE = 1e-3
_SAME_GRID = 1e-7  # Difference in m that comes from single precision


def grey_scale(dynamic_range_db: float | None) -> float:
    """Return dB per grey level of images that show so many dB in all; 60 by default."""
    if dynamic_range_db is None:
        return DECIBELS_PER_LEVEL
    require_within("dynamic_range_db", dynamic_range_db, *DYNAMIC_RANGE_DB)
    return dynamic_range_db / 255


class ImagesToVolumes(ABC):
    """Maker of volumes from images, or from many 2D frames each, by `GreyLevels`."""

    takes_frames = False
    posed = False
    """Whether images themselves have told poses, by a matrix that moves."""

    def __init__(self, window: tuple[float, float] | None) -> None:
        self.grey = GreyLevels(window)

    def __call__(self, posed: PosedImage) -> Volume | NotFound:
        """Return the volume that an image completes, or why there is none; empty if none is due."""
        try:
            return self._make(posed)
        except ValueError as error:
            return NotFound(f"{posed.image.name}: {error}")

    def X_WL(self, posed: PosedImage) -> RigidTransform:
        """Pose of the sender's frame L in W, as the volume of an image has it."""
        return posed.X_WL

    @abstractmethod
    def _make(self, posed: PosedImage) -> Volume | NotFound:
        """Do what a call does, or raise a ValueError if the image makes no sense."""


class VolumeMaker(ImagesToVolumes):
    """Turns posed images into volumes; the first one decides about the grid.

    A grid is placed in the probe's frame as that of a file is (`make_file_grid`), with the sound in
    the direction ``depth`` of L. An image whose own matrix has moved since the first, as that of
    ``Image_Reference`` does, has its pose there. See `GreyLevels` for the window; the dB from black
    to white are by default what a scanner of this package says, or else 60. ValueError if one is
    not allowed.
    """

    def __init__(
        self,
        *,
        depth: str = "P",
        window: tuple[float, float] | None = None,
        dynamic_range_db: float | None = None,
    ) -> None:
        super().__init__(window)
        self._scale = None if dynamic_range_db is None else grey_scale(dynamic_range_db)
        make_file_grid(np.eye(3), np.zeros(3), (2, 2, 2), depth)
        self._depth = depth
        self._grid: FileGrid | None = None
        self._shape: tuple[int, ...] = ()
        self._X_LI: NDArray[np.float64] = np.eye(4)
        self._sender = "", ""

    def X_WL(self, posed: PosedImage) -> RigidTransform:
        """Pose of the sender's frame L in W, which moves with the image's own matrix."""
        assert self._grid is not None
        if posed.acquisition is not None:
            return posed.X_WL @ self._grid.X_LP.inverse()
        return posed.X_WL @ _moved(posed.image.X_LI, self._X_LI)

    def _make(self, posed: PosedImage) -> Volume:
        image = posed.image
        if self._grid is None or (posed.sender != self._sender and not self._fits(image)):
            chosen = self._place(image)
        else:
            chosen = self._grid, self._shape, self._X_LI
        grid, shape, X_LI = chosen
        if image.voxels.shape != shape:
            raise ValueError(
                f"a volume of {image.voxels.shape} numbers is left out; the first had {shape}"
            )
        voxels = grid.arrange(image.voxels)
        void = void_flags(voxels)
        if void is not None and void.all():
            raise ValueError("a volume holds values that are not finite")
        volume = self._volume(posed, seal(self.grey(voxels, void)), grid, X_LI)
        if void is not None:
            volume = replace(volume, mask=~void)
        volume = volume.without_cut()
        # Only an image that made a volume decides about those that follow.
        self._grid, self._shape, self._X_LI = chosen
        self._sender = posed.sender
        return volume

    def _volume(
        self,
        posed: PosedImage,
        grey: NDArray[Any],
        grid: FileGrid,
        X_LI: NDArray[np.float64],
    ) -> Volume:
        said = posed.acquisition
        if said is not None:
            if not np.allclose(said.spacing, grid.spacing, rtol=1e-4, atol=0):
                raise ValueError("a volume is left out: the text before it tells another grid")
            (motion,) = said.motions if posed.time == said.times[0] else (None,)
            return Volume(
                grey,
                said.origin,
                said.spacing,
                posed.X_WL,
                posed.time,
                motion,
                self._scale or said.decibels_per_level or DECIBELS_PER_LEVEL,
                said.point_spread,
            )
        moved = _moved(posed.image.X_LI, X_LI)
        self.posed |= not moved.IsExactlyIdentity()
        X_WP = posed.X_WL @ moved @ grid.X_LP
        return Volume(
            grey,
            grid.origin,
            grid.spacing,
            X_WP,
            posed.time,
            decibels_per_level=self._scale or DECIBELS_PER_LEVEL,
        )

    def _fits(self, image: ImageItem) -> bool:
        """Return whether an image has the first one's grid, perhaps moved."""
        try:
            _moved(image.X_LI, self._X_LI)
        except ValueError:
            return False
        return image.voxels.shape == self._shape

    def _place(self, image: ImageItem) -> tuple[FileGrid, tuple[int, ...], NDArray[np.float64]]:
        """Return the grid of an image in P, and what later images are compared with."""
        directions = 1e3 * image.X_LI[:3, :3]
        require_voxels(Path(image.name), image.voxels.shape)
        check_grid(Path(image.name), image.voxels.shape, directions, 1e3 * image.X_LI[:3, 3])
        count: Any = image.voxels.shape
        grid = make_file_grid(directions, 1e3 * image.X_LI[:3, 3], count, self._depth)
        return grid, count, image.X_LI


def _moved(X_LI: NDArray[np.float64], first: NDArray[np.float64]) -> RigidTransform:
    """Return the motion in L that takes the first image's grid to this one's."""
    if np.abs(X_LI - first).max() < _SAME_GRID:
        return RigidTransform()
    motion = X_LI @ np.linalg.inv(first)
    R = motion[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > _RIGHT_ANGLE or np.linalg.det(R) < 0:
        steps = (
            " x ".join(f"{1e3 * each:.3g}" for each in np.linalg.norm(X[:3, :3], axis=0))
            for X in (X_LI, first)
        )
        raise ValueError(
            "a volume is left out: its grid is not the first one's, moved; its voxels have {} mm, "
            "the first one's {}. If the depth was changed, start again".format(*steps)
        )
    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), motion[:3, 3])
