"""Positions at which a volume shows what was elsewhere when each of its frames was acquired."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.sweep import SweepMotion


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
