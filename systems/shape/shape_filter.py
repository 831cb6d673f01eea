"""Interface of the shape filters, which update a belief about a needle's shape, and their prior."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.bicycle_paths import require_rising
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.requirements import (
    Positive,
    check_bounds,
    require,
    require_not_negative,
)

Floats = NDArray[np.float64]

MAX_PARTICLES = 100_000
"""Largest number of particles, which take some seconds a slice."""


@dataclass(kw_only=True)
class ShapeEstimatorParameters:
    """Prior knowledge of every shape estimator.

    The insertion's frame I is the probe's frame P at the first slice that shows the needle. Depths
    are along its Z axis.

    Parameters
    ----------
    depth
        Depth down to which the shape is predicted, in m.
    rotations
        Depths at which the bevel is turned by 180 deg, in m, in ascending order.
    observe_until
        Depth beyond which slices are not used, in m (the paper's D); None uses all.
    mean_radius, radius_std
        Mean and standard deviation of the normal distribution of R, in m. The paper uses 1500 mm
        and 600 mm.
    angle_std_deg
        Standard deviation of the normal distribution of theta_0 about zero, in deg. The paper's 5
        is in degrees.

    Raises
    ------
    ValueError
        If a rotation lies outside the insertion or a value is out of range.
    """

    depth: Positive = 0.14
    rotations: list[float] = field(default_factory=list)
    observe_until: float | None = None
    mean_radius: Positive = 1.5
    radius_std: Positive = 0.6
    angle_std_deg: Positive = 5.0

    def __post_init__(self) -> None:
        check_bounds(self)
        require_rising(self.rotations)
        require(
            not self.rotations or self.rotations[-1] < self.depth,
            "rotations",
            self.rotations,
            f"within the insertion, below depth ({self.depth} m)",
        )
        if self.observe_until is not None:
            require_not_negative(observe_until=self.observe_until)

    def _require_min_radius(self, min_radius: float) -> None:
        """Check the smallest radius in m of an estimator that has one."""
        allowed = "above 0 and below mean_radius"
        require(0 < min_radius < self.mean_radius, "min_radius", min_radius, allowed)

    @property
    def angle_std(self) -> float:
        """Standard deviation of theta_0, in rad."""
        return float(np.deg2rad(self.angle_std_deg))


class ShapePaths(NamedTuple):
    """Weighted paths of the bicycle model; see the fields of `NeedleShape` with the same names."""

    parameters: Floats
    origins: Floats
    weights: Floats
    origin_variance: float = 0.0
    wander: Any = None  # (n, k, 2), unless every curvature is constant
    wander_length: float = 0.02


class ShapeFilter(Protocol):
    """Filter for the shape of a needle; its beliefs are immutable values of its own type."""

    @property
    def parameters(self) -> ShapeEstimatorParameters:
        """Parameters common to all filters: depth, rotations, prior."""

    def begin(self, rng: np.random.Generator) -> Any:
        """Return the belief before any measurement."""

    def update(self, belief: Any, point: Floats, rng: np.random.Generator) -> Any:
        """Return the belief after one more measurement, (3,) x, y and depth in I, in m."""

    def represent(self, belief: Any, rng: np.random.Generator) -> ShapePaths | NotFound:
        """Return paths that represent the belief, or the reason why there are none yet."""
