"""Radio-frequency echoes of one sweep."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, own
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import SweepMotion


@dataclass(frozen=True, eq=False)
class RadioFrequencySweep(Immutable):
    """Radio-frequency echoes of one sweep, before envelope detection."""

    lines: NDArray[np.float32]
    """(frames, lines, samples) echoes. Their values are not checked, which would take as long as
    all further processing."""

    motion: SweepMotion
    """Time and pose at which each frame was acquired."""

    point_spread: PointSpread | None = None
    """Resolution of the transducer; None if unknown."""

    def __post_init__(self) -> None:
        lines = own(np.asarray(self.lines, dtype=np.float32))
        shape = self.motion.geometry.shape
        require(lines.shape == shape, "lines.shape", lines.shape, f"{shape}")
        object.__setattr__(self, "lines", lines)

    @property
    def time(self) -> float:
        """Middle of the acquisition, in s."""
        return self.motion.time

    @property
    def X_WP(self) -> RigidTransform:
        """Pose of the probe in the world when the middle frame was acquired."""
        return RigidTransform(self.motion.X_WP[self.motion.geometry.frames // 2])

    def index(self, p_P: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 3) fractional frame, line and sample of (..., 3) positions in P in m."""
        return np.stack(self.motion.geometry.index(p_P, self.motion.direction), axis=-1)

    def position(self, index: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 3) positions in P, in m, of (..., 3) frames, lines and samples."""
        k, j, i = np.moveaxis(np.asarray(index, dtype=float), -1, 0)
        return self.motion.geometry.position(k, j, i, self.motion.direction)

    def to_world(self, p_P: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions in W and times of (m, 3) positions in P; see `SweepMotion.to_world`."""
        return self.motion.to_world(p_P)

    def to_probe(self, p_W: ArrayLike) -> NDArray[np.float64]:
        """Return the (m, 3) positions in P, in m, of positions in W, for the pose `X_WP`."""
        return self.X_WP.inverse().multiply(np.asarray(p_W, dtype=float).T).T.reshape(-1, 3)
