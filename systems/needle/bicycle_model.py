"""The path that a bevelled needle cuts: the bicycle model, stepwise and in closed form.

Carriere et al. 2016, section III. Two of its equations are corrected here:

* Eq. 2 adds the bevel's angle beta to the tip's angle theta. In the bicycle model the angle
  changes by alpha sin(beta) / l per step, that is by alpha / R. Eqs. 2 and 5 also swap sin(phi) and
  cos(phi), and eq. 5 says y = sin(phi) v; x = cos(phi) u and y = sin(phi) u are meant.
* Eqs. 3 and 4 taken with equal signs give a path that starts with slope -tan(theta). Consistent is

      u = u_turn + s (R cos(theta_turn) - sqrt(R^2 - (v - v_c)^2))

  with v_c = v_turn - s R sin(theta_turn) and s = +-1; at a rotation s changes its sign, and theta
  goes on from where it is. The centre of the circle is at u_c = u_turn + s R cos(theta_turn).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.bicycle_paths import deflections, require_rising
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require, require_positive

Floats = NDArray[np.float64]


def bicycle_step(state: ArrayLike, distance: float, curvature: float) -> Floats:
    """Push the needle's tip one step (eq. 2, corrected).

    Parameters
    ----------
    state
        (5,) x, y, z of the tip in m, its angle theta to Z in rad, and the angle phi of the plane of
        deflection about Z in rad.
    distance
        Step alpha along the path, in m.
    curvature
        sin(beta) / l = 1 / R, in 1/m, below zero once the bevel is turned by 180 deg.

    Returns
    -------
    (5,) the next state.
    """
    _, _, _, theta, phi = state = np.asarray(state, dtype=float)
    sine, cosine = np.sin(theta), np.cos(theta)
    change = [sine * np.cos(phi), sine * np.sin(phi), cosine, curvature, 0.0]
    return state + distance * np.array(change)


@dataclass(frozen=True)
class BicyclePath(Immutable):
    """The path of a tip that turns with constant curvature within one plane.

    Frame I of the insertion: Z along it, the path starts at the origin. The plane of deflection
    contains Z; u is the deflection in it, v the depth along Z.

    Parameters
    ----------
    radius
        R in m.
    angle
        theta_0 between the first direction and Z, in rad, towards +u.
    plane
        phi, from X to the plane's u, in rad.
    rotations
        Depths v in m at which the bevel is turned by 180 deg, in rising order. The curvature is
        towards +u before the first one.

    Raises
    ------
    ValueError
        If a value is out of range; the message names it.
    """

    radius: float
    angle: float = 0.0
    plane: float = 0.0
    rotations: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        require_positive(radius=self.radius)
        require(abs(self.angle) < np.pi / 2, "angle", self.angle, "below 90 deg")
        require_rising(self.rotations)

    def deflection(self, depth: ArrayLike) -> Floats:
        """Deflection u in m at depths v in m, in closed form (eqs. 3 and 4, corrected).

        Raises
        ------
        ValueError
            If the path turns back before it reaches a depth.
        """
        depth = np.asarray(depth, dtype=float)
        order = np.argsort(depth, axis=None)
        parameters = np.array([[1 / self.radius, np.sin(self.angle)]])
        out = np.empty(depth.size)
        out[order] = deflections(parameters, depth.ravel()[order], np.array(self.rotations))[0]
        require(bool(np.isfinite(out).all()), "depth", float(depth.max()), "one the path reaches")
        return out.reshape(depth.shape)

    def position(self, depth: ArrayLike) -> Floats:
        """(..., 3) positions in I, in m, at depths in m (eq. 5, corrected)."""
        depth = np.asarray(depth, dtype=float)
        u = self.deflection(depth)
        return np.stack([np.cos(self.plane) * u, np.sin(self.plane) * u, depth], axis=-1)

    def along(self, length: ArrayLike) -> Floats:
        """(..., 3) positions in I, in m, at lengths along the path in m, from 0.

        Raises
        ------
        ValueError
            If a rotation lies where the path no longer goes deeper.
        """
        length = np.asarray(length, dtype=float)
        u, v = np.zeros(length.shape), np.zeros(length.shape)
        start, theta, sign = np.zeros(3), self.angle, 1.0  # length, u and v where a piece begins
        for depth in (*self.rotations, np.inf):
            sine = np.sin(theta) + sign * (depth - start[2]) / self.radius
            last = depth == np.inf
            require(last or abs(sine) < 1, "rotations", depth, "depths that the path reaches")
            s = length - start[0]
            here = s >= 0
            turned = theta + sign * s[here] / self.radius
            u[here] = start[1] + sign * self.radius * (np.cos(theta) - np.cos(turned))
            v[here] = start[2] + sign * self.radius * (np.sin(turned) - np.sin(theta))
            if not last:
                end = np.arcsin(sine)
                start = np.array(
                    [
                        start[0] + sign * self.radius * (end - theta),
                        start[1] + sign * self.radius * (np.cos(theta) - np.cos(end)),
                        depth,
                    ]
                )
                theta, sign = end, -sign
        return np.stack([np.cos(self.plane) * u, np.sin(self.plane) * u, v], axis=-1)
