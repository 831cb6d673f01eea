"""Estimated shape of a needle, from its entry to its full depth, with uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.curvature_wander import wander_modes
from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NeedleShape(Immutable):
    """Belief of a shape estimator: a weighted set of paths of the bicycle model.

    The curvature of a path may wander along it, which adds a deflection along X and along Y of I.
    """

    parameters: Annotated[Floats, Shape("n", 3)]
    """Radius R in m, first angle theta_0 and plane phi in rad, of each path."""

    origins: Annotated[Floats, Shape("n", 2)]
    """x and y in I at depth 0 of each path, in m."""

    weights: Annotated[Floats, Shape("n")]
    """Weights of the paths, with a sum of 1."""

    origin_variance: float
    """Additional variance of x and of y of each path's origin, in m^2."""

    rotations: tuple[float, ...]
    """Depths at which the bevel is turned, in m."""

    depth: float
    """Depth of the tip when the needle is fully inserted, in m."""

    observed: float
    """Depth of the last slice that was used, in m."""

    X_WI: RigidTransform
    """Pose of the insertion's frame in W."""

    time: float
    """Time of the last slice that was used, in s."""

    reason: str = ""
    """Reason why the newest slice was not used; empty if it was."""

    wander: Annotated[Floats, Shape("n", None, 2)] | None = None
    """Coefficients of `wander_modes` along X and along Y, in 1/m; None if the curvature of each
    path is constant."""

    wander_length: float = 0.02
    """Length in m of the modes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        total = self.weights.sum()
        require(abs(total - 1) < 1e-6, "sum of weights", total, "1")

    def paths(self, depths: ArrayLike) -> Floats:
        """Return (n, m, 2) x and y in I, in m, of every path at (m,) ascending depths in m."""
        paths = self.origins[:, np.newaxis] + bicycle_paths(self.parameters, depths, self.rotations)
        if self.wander is None or not self.wander.size:
            return paths
        modes = wander_modes(self.depth, self.rotations, self.wander_length).at(depths)
        wandering: Floats = paths + np.matmul(modes, self.wander)
        return wandering

    def predict(self, depths: ArrayLike) -> tuple[Floats, Floats]:
        """Return (m, 2) mean in m and (m, 2, 2) covariance in m^2 in I at rising depths."""
        mean, covariance = path_statistics(self.paths(depths), self.weights)
        return mean, covariance + self.origin_variance * np.eye(2)

    @property
    def tip(self) -> Floats:
        """(3,) predicted tip of the fully inserted needle in W, in m."""
        return self.positions([self.depth])[0]

    def positions(self, depths: ArrayLike) -> Floats:
        """Return (m, 3) predicted positions in W, in m, at (m,) ascending depths in m."""
        depths = np.asarray(depths, dtype=float)
        mean = np.tensordot(self.weights, self.paths(depths), 1)
        p_I = np.column_stack([mean, depths])
        p_W: Floats = self.X_WI.multiply(p_I.T).T.reshape(-1, 3)
        return p_W

    def std(self, depths: ArrayLike) -> Floats:
        """Return the (m,) largest standard deviations of the position across the insertion in m."""
        return np.sqrt(np.linalg.eigvalsh(self.predict(depths)[1])[:, -1])


def bicycle_paths(parameters: Floats, depths: ArrayLike, rotations: Sequence[float]) -> Floats:
    """Return (n, m, 2) x and y in m of paths with (n, 3) R, theta_0 and phi; NaN past a turn."""
    radius, angle, plane = np.asarray(parameters, dtype=float).T
    u = deflections(
        np.column_stack([1 / radius, np.sin(angle)]),
        np.asarray(depths, dtype=float),
        np.asarray(rotations, dtype=float),
    )
    return np.stack([u * np.cos(plane)[:, np.newaxis], u * np.sin(plane)[:, np.newaxis]], axis=-1)


def path_statistics(paths: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Return (m, 2) mean and (m, 2, 2) covariance of (n, m, 2) paths with (n,) weights."""
    mean = np.tensordot(weights, paths, 1)
    apart = (paths - mean) * np.sqrt(weights)[:, np.newaxis, np.newaxis]
    return mean, np.einsum("nmi,nmj->mij", apart, apart)
