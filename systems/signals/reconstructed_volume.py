"""Volume reconstructed from 2D frames, each with its own pose and time."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.immutable import Shape, own, seal
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.volume import Volume


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
