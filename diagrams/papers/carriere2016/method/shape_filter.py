"""Particle filter of Carriere 2016, section IV, step by step as printed, for comparison.

The paper leaves some points open. They are decided as follows:

* gamma is not published. It is the parameter `gain`.
* The first of the p points would be the origin, through which every particle passes. The p points
  are therefore at v_k i / p, with i from 1 to p.
* Principal components do not determine the sense of u. The mark on a needle's hub does, as it shows
  the side to which the bevel bends. It is the parameter `bevel_direction_deg`. Without it, u points
  to the needle's position at 10 mm.
* Step 7 updates "all other particles", so those that pass closest stay. Step 9 does not say which
  particles are removed: those that fit worst.
* phi is found from all points so far. Section III has it constant, and a constant is the better
  known the more points there are: at 10 mm, the needle is a few hundredths of a millimetre off a
  straight line, and phi would be mostly noise.

The uncertainty is the spread of the particles, as in the paper. It says little about the error.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.shape.shape_filter import (
    MAX_PARTICLES,
    ShapeEstimatorParameters,
    ShapePaths,
)
from sonoservo.systems.shape.shape_filters import ShapeFilterChoice
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.requirements import (
    Positive,
    at_least,
    require,
    require_within,
)

Floats = NDArray[np.float64]

_SHARPEST_CURVATURE = 5.0
"""Largest curvature in 1/m with which a path is drawn."""


@dataclass(kw_only=True)
class PublishedParticleFilterParameters(ShapeEstimatorParameters):
    """Parameters of the published filter, in addition to those of every shape estimator.

    Parameters
    ----------
    particles
        Number of particles n.
    points
        Number of points p.
    replaced
        Number c of particles that are replaced in every step.
    gain
        Gain gamma.
    start_depth
        Depth at which the filter starts, in m.
    bevel_direction_deg
        Approximate direction in which the bevel bends, from X towards Y of I, in deg; None if
        unknown.
    """

    particles: int = 500
    points: Annotated[int, at_least(2)] = 5
    replaced: int = 3
    gain: float = 0.05
    start_depth: Positive = 10e-3
    bevel_direction_deg: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("particles", self.particles, 10, MAX_PARTICLES)
        require(
            0 <= self.replaced < self.particles,
            "replaced",
            self.replaced,
            "at least 0 and below particles",
        )
        require(0 < self.gain <= 1, "gain", self.gain, "above 0 and at most 1")


@dataclass(frozen=True, eq=False)
class PublishedBelief(Immutable):
    """Particles (n, 2), R in m and theta_0 in rad, and (m, 3) measured x, y, depth in I, in m."""

    particles: Floats
    points: Floats
    plane: float | None = None


class PublishedParticleFilter:
    """Published particle filter, a `ShapeFilter`."""

    def __init__(self, parameters: PublishedParticleFilterParameters) -> None:
        self.parameters = parameters

    def begin(self, rng: np.random.Generator) -> PublishedBelief:
        """Draw particles from the first distribution (step 1)."""
        p = self.parameters
        radius = rng.normal(p.mean_radius, p.radius_std, p.particles)
        angle = rng.normal(0.0, p.angle_std, p.particles)
        return PublishedBelief(np.column_stack([radius, angle]), np.zeros((0, 3)))

    def update(
        self, belief: PublishedBelief, point: Floats, rng: np.random.Generator
    ) -> PublishedBelief:
        """Take one more measurement, (3,) x, y and depth in I, in m (steps 2 to 10)."""
        parameters = self.parameters
        points = np.vstack([belief.points, point])
        apart = points - points[0]
        if len(points) < parameters.points or apart[-1, 2] < parameters.start_depth:
            return PublishedBelief(belief.particles, points)
        plane = _plane_of_deflection(apart[:, :2], parameters.bevel_direction_deg)
        # Step 2: the measured points nearest to p points at equal distances.
        depths = apart[-1, 2] * np.arange(1, parameters.points + 1) / parameters.points
        chosen = np.abs(apart[:, 2] - depths[:, np.newaxis]).argmin(axis=1)
        chosen = chosen[np.argsort(apart[chosen, 2])]
        measured = apart[chosen, 0] * np.cos(plane) + apart[chosen, 1] * np.sin(plane)
        # Steps 3 to 6: the mean of the particles that pass closest to each point.
        particles = belief.particles
        shapes = np.column_stack([_curvature(particles[:, 0]), np.sin(particles[:, 1])])
        rotations = np.array(parameters.rotations, dtype=float)
        predicted = deflections(shapes, apart[chosen, 2], rotations)
        distance = np.where(np.isfinite(predicted), np.abs(measured - predicted), np.inf)
        closest = distance.argmin(axis=0)
        best = particles[closest].mean(axis=0)
        # Step 7 updates all other particles. Steps 8 and 9 replace those that fit worst.
        gain = np.full((len(particles), 1), parameters.gain)
        gain[closest] = 0
        particles = particles - gain * (particles - best)
        mean, std = particles.mean(axis=0), particles.std(axis=0)
        worst = distance.sum(axis=1).argsort(kind="stable")[::-1][: parameters.replaced]
        particles[worst] = rng.normal(mean, std, (parameters.replaced, 2))
        return PublishedBelief(particles, points, plane)

    def represent(self, belief: PublishedBelief, rng: np.random.Generator) -> ShapePaths | NotFound:
        """Return 4 paths with the particles' mean and spread, or the reason why there are none."""
        if belief.plane is None:
            return NotFound(
                f"the filter starts at a depth of {1e3 * self.parameters.start_depth:g} mm, "
                f"with {self.parameters.points} points"
            )
        radius, angle = belief.particles.mean(axis=0)
        std = np.sqrt(2) * belief.particles.std(axis=0)
        curvature = float(_curvature(radius))
        steps = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        curvatures = curvature + steps[:, 0] * std[0] * curvature**2
        curvatures = np.clip(curvatures, -_SHARPEST_CURVATURE, _SHARPEST_CURVATURE)
        curvatures = np.where(np.abs(curvatures) < 1e-9, 1e-9, curvatures)
        angles = np.clip(angle + steps[:, 1] * std[1], -1.0, 1.0)
        return ShapePaths(
            parameters=np.column_stack([1 / curvatures, angles, np.full(4, belief.plane)]),
            origins=np.tile(belief.points[0, :2], (4, 1)),
            weights=np.full(4, 0.25),
        )


def _curvature(radius: Floats) -> Floats:
    """Return 1 / R in 1/m, limited because R is drawn from a normal distribution."""
    least = 1 / _SHARPEST_CURVATURE
    return 1 / np.where(np.abs(radius) < least, np.copysign(least, radius), radius)


def _plane_of_deflection(points: Floats, bevel_direction_deg: float | None) -> float:
    """Return phi in rad by principal component analysis of (m, 2) deflections in m."""
    _, _, axes = np.linalg.svd(points - points.mean(axis=0))
    if bevel_direction_deg is None:
        towards = points.mean(axis=0)
    else:
        turn = np.deg2rad(bevel_direction_deg)
        towards = np.array([np.cos(turn), np.sin(turn)])
    axis = axes[0] if axes[0] @ towards >= 0 else -axes[0]
    return float(np.arctan2(axis[1], axis[0]))


PUBLISHED = {
    "published": ShapeFilterChoice(PublishedParticleFilterParameters, PublishedParticleFilter)
}
"""Parameters and filter, by the name that a scenario chooses."""
