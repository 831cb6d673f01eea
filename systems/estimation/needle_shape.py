"""The shape that a needle has and will have, and how sure that is."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.needle.bicycle_model import deflections, require_rising
from sonoservo.systems.values import (
    Immutable,
    read_only,
    require,
    require_not_negative,
    require_positive,
)

Floats = NDArray[np.float64]


@dataclass(kw_only=True)
class ShapeEstimatorParameters:
    """What every shape estimator knows before the first slice.

    Frame I of the insertion: the probe's frame P at the first slice that showed the needle; depths
    are along its Z.

    Parameters
    ----------
    depth
        To which the shape is predicted, in m.
    rotations
        Depths at which the bevel is turned by 180 deg, in m, in rising order.
    observe_until
        Depth beyond which slices are not looked at, in m (the paper's D); None looks at all.
    mean_radius, radius_deviation
        Of the normal distribution of R, in m. The paper's, 1500 and 600 mm.
    angle_deviation_deg
        Of the normal distribution of theta_0 about zero. The paper's 5 is in degrees.

    Raises
    ------
    ValueError
        If a rotation lies outside the insertion or a value is out of range.
    """

    depth: float = 0.14
    rotations: list[float] = field(default_factory=list)
    observe_until: float | None = None
    mean_radius: float = 1.5
    radius_deviation: float = 0.6
    angle_deviation_deg: float = 5.0

    def __post_init__(self) -> None:
        require_positive(
            depth=self.depth,
            mean_radius=self.mean_radius,
            radius_deviation=self.radius_deviation,
            angle_deviation_deg=self.angle_deviation_deg,
        )
        require_rising(self.rotations)
        require(
            not self.rotations or self.rotations[-1] < self.depth,
            "rotations",
            self.rotations,
            f"within the insertion, below depth ({self.depth} m)",
        )
        if self.observe_until is not None:
            require_not_negative(observe_until=self.observe_until)

    @property
    def angle_deviation(self) -> float:
        """Of theta_0, in rad."""
        return float(np.deg2rad(self.angle_deviation_deg))


@dataclass(frozen=True, eq=False)
class NeedleShape(Immutable):
    """A weighted set of paths of the bicycle model: what a shape estimator believes.

    Parameters
    ----------
    parameters
        (n, 3) radius R in m, first angle theta_0 and plane phi in rad, of each path.
    origins
        (n, 2) x and y in I at depth 0 of each path, in m.
    weights
        (n,) of the paths; their sum is 1.
    origin_variance
        Of x and of y that each path has besides, in m^2.
    rotations
        Depths at which the bevel is turned, in m.
    depth
        Of the tip when the needle is fully inserted, in m.
    observed
        Depth of the last slice that was used, in m.
    X_WI
        Pose of the insertion's frame in W.
    time
        Of that slice, in s.
    reason
        Why the newest slice was not used; empty where it was.
    """

    parameters: Floats
    origins: Floats
    weights: Floats
    origin_variance: float
    rotations: tuple[float, ...]
    depth: float
    observed: float
    X_WI: RigidTransform
    time: float
    reason: str = ""

    def __post_init__(self) -> None:
        n = len(self.parameters)
        for name, shape in (("parameters", (n, 3)), ("origins", (n, 2)), ("weights", (n,))):
            object.__setattr__(self, name, read_only(getattr(self, name), name, shape))
        require(abs(self.weights.sum() - 1) < 1e-6, "weights", self.weights.sum(), "1 in sum")

    def paths(self, depths: ArrayLike) -> Floats:
        """(n, m, 2) x and y in I, in m, of every path at (m,) rising depths in m."""
        return self.origins[:, np.newaxis] + bicycle_paths(self.parameters, depths, self.rotations)

    def predict(self, depths: ArrayLike) -> tuple[Floats, Floats]:
        """Mean and covariance of the needle's position across the insertion.

        Parameters
        ----------
        depths
            (m,) in m, in rising order.

        Returns
        -------
        mean, covariance
            (m, 2) in m, and (m, 2, 2) in m^2, of x and y in I.
        """
        mean, covariance = path_statistics(self.paths(depths), self.weights)
        return mean, covariance + self.origin_variance * np.eye(2)

    @property
    def tip(self) -> Floats:
        """(3,) predicted tip of the fully inserted needle in W, in m."""
        return self.positions([self.depth])[0]

    def positions(self, depths: ArrayLike) -> Floats:
        """(m, 3) predicted positions in W, in m, at (m,) rising depths in m."""
        depths = np.asarray(depths, dtype=float)
        mean = np.tensordot(self.weights, self.paths(depths), 1)
        p_I = np.column_stack([mean, depths])
        p_W: Floats = self.X_WI.multiply(p_I.T).T.reshape(-1, 3)
        return p_W

    def deviation(self, depths: ArrayLike) -> Floats:
        """(m,) largest standard deviation of the position across the insertion, in m."""
        return np.sqrt(np.linalg.eigvalsh(self.predict(depths)[1])[:, -1])


def bicycle_paths(
    parameters: Floats, depths: ArrayLike, rotations: tuple[float, ...] | list[float]
) -> Floats:
    """(n, m, 2) x and y in m, from the origin, of the paths with (n, 3) R, theta_0 and phi.

    Where a path turns back, its place is NaN.
    """
    radius, angle, plane = np.asarray(parameters, dtype=float).T
    u = deflections(
        np.column_stack([1 / radius, np.sin(angle)]),
        np.asarray(depths, dtype=float),
        np.asarray(rotations, dtype=float),
    )
    return np.stack([u * np.cos(plane)[:, np.newaxis], u * np.sin(plane)[:, np.newaxis]], axis=-1)


def path_statistics(paths: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """Mean (m, 2) and covariance (m, 2, 2) of (n, m, 2) paths with (n,) weights."""
    mean = np.tensordot(weights, paths, 1)
    apart = (paths - mean) * np.sqrt(weights)[:, np.newaxis, np.newaxis]
    return mean, np.einsum("nmi,nmj->mij", apart, apart)
