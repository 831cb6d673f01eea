"""Paths whose deflection is magnified, to show a bend that is too small to be seen to scale."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

Floats = NDArray[np.float64]


class Magnifier:
    """Map from W to a place above, where paths keep their depth and bend more than they do.

    Parameters
    ----------
    X_WI
        Pose of the probe at the first slice: Z is the depth, Y points away from the probe.
    origin
        (2,) x and y in I, in m, from which the deflection is taken.
    scale
        Magnification of the deflection.
    lift
        Distance in m by which the magnified path stands above the true one.
    """

    def __init__(
        self, X_WI: RigidTransform, origin: ArrayLike, *, scale: float, lift: float
    ) -> None:
        self._X_WI = X_WI
        self._origin = np.asarray(origin, dtype=float)
        self._scale, self._lift = scale, lift

    def deflection(self, p_W: ArrayLike) -> Floats:
        """Return the (m, 3) positions in I of (m, 3) points in W, from the origin on; all in m."""
        p_I = self._X_WI.inverse().multiply(np.asarray(p_W, dtype=float).T).T.reshape(-1, 3)
        return p_I - [*self._origin, 0.0]

    def __call__(self, p_W: ArrayLike) -> Floats:
        """Return the (m, 3) magnified positions in W of (m, 3) points in W, in m."""
        p_I = self.deflection(p_W) * [self._scale, self._scale, 1.0]
        return self._to_world(p_I)

    def axis(self, depths: ArrayLike) -> Floats:
        """Return the (m, 3) points in W of a path without deflection, at (m,) depths in m."""
        depths = np.asarray(depths, dtype=float)
        return self._to_world(np.stack([0 * depths, 0 * depths, depths], axis=1))

    def _to_world(self, p_I: Floats) -> Floats:
        x, y = self._origin
        p_W: Floats = self._X_WI.multiply((p_I + np.array([x, y - self._lift, 0.0])).T).T
        return p_W
