"""The particle filter of Carriere 2016, section IV, step by step as printed.

It is here to be compared with. What the paper leaves open is decided so:

* gamma is unpublished: `gain`.
* The first of the p points would be the origin, which every particle passes: the p points are at
  v_k i / p, i from 1 to p.
* Principal components do not tell which way u points. The side to which the bevel bends, which
  the mark on a needle's hub shows, does: `bevel_direction_deg`; without it, u points to where the
  needle is at 10 mm.
* phi is found once, at 10 mm, as section III wants it constant. There the needle is a few
  hundredths of a millimetre off a straight line, so phi is mostly noise.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.shape_parameters import ShapeEstimatorParameters
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require, require_positive

Floats = NDArray[np.float64]

_SHARPEST_CURVATURE = 5.0
"""In 1/m: paths that bend more are drawn with this."""


@dataclass(kw_only=True)
class PublishedParticleFilterParameters(ShapeEstimatorParameters):
    """Of the published filter, besides what every shape estimator knows.

    Parameters
    ----------
    particles
        n.
    points
        p.
    replaced
        c, the particles that are replaced at every step.
    gain
        gamma.
    start_depth
        Depth at which the filter starts, in m.
    bevel_direction_deg
        Roughly the direction in which the bevel bends, from X towards Y of I; None if unknown.
    """

    particles: int = 500
    points: int = 5
    replaced: int = 3
    gain: float = 0.3
    start_depth: float = 10e-3
    bevel_direction_deg: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.particles >= 10, "particles", self.particles, "at least 10")
        require(self.points >= 2, "points", self.points, "at least 2")
        require(
            0 <= self.replaced < self.particles,
            "replaced",
            self.replaced,
            "from 0, below particles",
        )
        require(0 < self.gain <= 1, "gain", self.gain, "above 0, at most 1")
        require_positive(start_depth=self.start_depth)


@dataclass(frozen=True, eq=False)
class PublishedBelief(Immutable):
    """The particles, and what was measured.

    Parameters
    ----------
    particles
        (n, 2) R in m and theta_0 in rad.
    points
        (m, 3) measured x, y and depth in I, in m.
    plane
        phi in rad; None before the start depth.
    """

    particles: Floats
    points: Floats
    plane: float | None = None


def begin(
    parameters: PublishedParticleFilterParameters, rng: np.random.Generator
) -> PublishedBelief:
    """Step 1: particles drawn from the first distribution."""
    p = parameters
    radius = rng.normal(p.mean_radius, p.radius_std, p.particles)
    angle = rng.normal(0.0, p.angle_std, p.particles)
    return PublishedBelief(np.column_stack([radius, angle]), np.zeros((0, 3)))


def update(
    belief: PublishedBelief,
    point: Floats,
    parameters: PublishedParticleFilterParameters,
    rng: np.random.Generator,
) -> PublishedBelief:
    """Steps 2 to 10, with one more measurement (3,): x, y and depth in I, in m."""
    points = np.vstack([belief.points, point])
    apart = points - points[0]
    if len(points) < parameters.points or apart[-1, 2] < parameters.start_depth:
        return PublishedBelief(belief.particles, points)
    plane = belief.plane
    if plane is None:
        plane = _plane_of_deflection(apart[:, :2], parameters.bevel_direction_deg)
    # Step 2: p points at equal distances, the measured ones that are nearest.
    depths = apart[-1, 2] * np.arange(1, parameters.points + 1) / parameters.points
    chosen = np.abs(apart[:, 2] - depths[:, np.newaxis]).argmin(axis=1)
    chosen = chosen[np.argsort(apart[chosen, 2])]
    measured = apart[chosen, 0] * np.cos(plane) + apart[chosen, 1] * np.sin(plane)
    # Steps 3 to 6: for each point the particle that passes it most closely; their mean.
    particles = belief.particles
    shapes = np.column_stack([_curvature(particles[:, 0]), np.sin(particles[:, 1])])
    predicted = deflections(shapes, apart[chosen, 2], np.array(parameters.rotations, dtype=float))
    distance = np.where(np.isfinite(predicted), np.abs(measured - predicted), np.inf)
    best = particles[distance.argmin(axis=0)].mean(axis=0)
    # Steps 7 to 9.
    particles = particles - parameters.gain * (particles - best)
    mean, deviation = particles.mean(axis=0), particles.std(axis=0)
    replaced = rng.choice(len(particles), parameters.replaced, replace=False)
    particles[replaced] = rng.normal(mean, deviation, (parameters.replaced, 2))
    return PublishedBelief(particles, points, plane)


def represent(belief: PublishedBelief) -> tuple[Floats, Floats]:
    """(4, 3) R, theta_0, phi and (4, 2) origins of paths with the particles' mean and spread.

    Pairs about the mean, whose paths' mean is the path of the mean parameters, which the paper
    predicts with.
    """
    assert belief.plane is not None
    radius, angle = belief.particles.mean(axis=0)
    deviation = np.sqrt(2) * belief.particles.std(axis=0)
    curvature = float(_curvature(radius))
    steps = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    curvatures = curvature + steps[:, 0] * deviation[0] * curvature**2
    curvatures = np.clip(curvatures, -_SHARPEST_CURVATURE, _SHARPEST_CURVATURE)
    curvatures = np.where(np.abs(curvatures) < 1e-9, 1e-9, curvatures)
    angles = np.clip(angle + steps[:, 1] * deviation[1], -1.0, 1.0)
    parameters = np.column_stack([1 / curvatures, angles, np.full(4, belief.plane)])
    return parameters, np.tile(belief.points[0, :2], (4, 1))


def _curvature(radius: Floats) -> Floats:
    """1 / R in 1/m, within what a path can have: R is drawn from a normal distribution."""
    least = 1 / _SHARPEST_CURVATURE
    return 1 / np.where(np.abs(radius) < least, np.copysign(least, radius), radius)


def _plane_of_deflection(points: Floats, bevel_direction_deg: float | None) -> float:
    """Phi in rad by principal component analysis of (m, 2) deflections in m."""
    _, _, axes = np.linalg.svd(points - points.mean(axis=0))
    if bevel_direction_deg is None:
        towards = points.mean(axis=0)
    else:
        turn = np.deg2rad(bevel_direction_deg)
        towards = np.array([np.cos(turn), np.sin(turn)])
    axis = axes[0] if axes[0] @ towards >= 0 else -axes[0]
    return float(np.arctan2(axis[1], axis[0]))
