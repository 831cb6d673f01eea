"""Bicycle model in closed form: the path that a bevelled needle cuts within one plane.

This is Carriere et al. 2016, section III, with two corrections to its equations:

* Eqs. 3 and 4 taken with equal signs give a path that starts with slope -tan(theta). The consistent
  form is

      u = u_turn + s (R cos(theta_turn) - sqrt(R^2 - (v - v_c)^2))

  with v_c = v_turn - s R sin(theta_turn) and s = +-1. At a rotation s changes its sign, and theta
  continues from its present value. The circle's centre is at u_c = u_turn + s R cos(theta_turn).
* Eq. 5 swaps sin(phi) and cos(phi), and has y = sin(phi) v. The correct form is x = cos(phi) u and
  y = sin(phi) u.

`SteeredPath` is the model in space, as a function of path length.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals import Immutable
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class BicyclePath(Immutable):
    """Path of a tip that turns with constant curvature within one plane.

    The insertion's frame I has its Z axis along the insertion and its origin at the start of the
    path. The plane of deflection contains Z. In it, u is the deflection and v the depth along Z.

    `radius` is in m, `angle` that between the first direction and Z in rad, towards +u, `plane`
    that from X to u in rad, and `rotations` the ascending depths at which the bevel is turned by
    180 deg, in m; the curvature is towards +u before the first one.
    """

    radius: float
    angle: float = 0.0
    plane: float = 0.0
    rotations: tuple[float, ...] = ()

    def deflection(self, depth: ArrayLike) -> Floats:
        """Return the deflection u in m at depths v in m (eqs. 3 and 4, corrected)."""
        depth = np.asarray(depth, dtype=float)
        order = np.argsort(depth, axis=None)
        parameters = np.array([[1 / self.radius, np.sin(self.angle)]])
        out = np.empty(depth.size)
        out[order] = deflections(parameters, depth.ravel()[order], np.array(self.rotations))[0]
        reached = bool(np.isfinite(out).all())
        require(reached, "depth", float(depth.max()), "a depth that the path reaches")
        return out.reshape(depth.shape)

    def position(self, depth: ArrayLike) -> Floats:
        """Return the (..., 3) positions in I, in m, at depths v in m (eq. 5, corrected)."""
        depth = np.asarray(depth, dtype=float)
        u = self.deflection(depth)
        return np.stack([np.cos(self.plane) * u, np.sin(self.plane) * u, depth], axis=-1)
