"""Particle filter for the shape of a needle whose parameters do not change.

It replaces the filter of Carriere 2016, section IV. That filter chooses the best particle for each
point separately and draws all particles towards these, and their spread vanishes whatever the data
are. Here every particle is weighted by the joint likelihood of all cross-sections. When few
particles carry most of the weight, they are resampled and moved by Metropolis steps that leave the
posterior unchanged (Chopin 2002, "A sequential particle filter method for static models").
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.shape.shape_filter import ShapePaths
from sonoservo.systems.estimation.shape.shape_parameters import (
    MAX_PARTICLES,
    ShapeEstimatorParameters,
)
from sonoservo.systems.estimation.shape.shape_posterior import (
    MeasurementNoise,
    about_best_origin,
    residual_sums,
)
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require, require_within

Floats = NDArray[np.float64]


@dataclass(kw_only=True)
class ShapeParticleFilterParameters(ShapeEstimatorParameters):
    """Parameters of the particle filter, in addition to those of every shape estimator.

    Parameters
    ----------
    particles
        Number of particles n.
    min_radius
        Smallest radius in m, at which the normal distribution of R is cut off.
    moves
        Number of Metropolis steps after each resampling.
    noise
        Noise of the measured cross-sections.
    """

    particles: int = 500
    min_radius: float = 0.2
    moves: int = 2
    noise: MeasurementNoise = field(default_factory=MeasurementNoise)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_within("particles", self.particles, 50, MAX_PARTICLES)
        require(self.moves >= 1, "moves", self.moves, "at least 1")
        require(
            0 < self.min_radius < self.mean_radius,
            "min_radius",
            self.min_radius,
            "above 0 and below mean_radius",
        )


@dataclass(frozen=True, eq=False)
class ParticleBelief(Immutable):
    """Particles, and the measurements by which they were weighted.

    Parameters
    ----------
    particles
        (n, 3) particles: R in m, theta_0 and phi in rad.
    log_weights
        (n,) logarithms of the particles' weights, up to a constant.
    sums
        (n, 3) sums of residuals; see `residual_sums`.
    points
        (m, 3) measured x, y and depth in I, in m.
    weights
        (m,) weights of the measurements.
    """

    particles: Floats
    log_weights: Floats
    sums: Floats
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    weights: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def normalized_weights(self) -> Floats:
        """(n,) weights of the particles, with a sum of 1."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        return weights / weights.sum()

    @property
    def total(self) -> float:
        """Sum of the measurements' weights."""
        return float(self.weights.sum())


class ShapePosterior:
    """Prior and likelihood of (n, 3) particles R, theta_0, phi."""

    def __init__(self, parameters: ShapeParticleFilterParameters) -> None:
        self._parameters = parameters
        self._rotations = np.array(parameters.rotations, dtype=float)

    def draw(self, rng: np.random.Generator) -> Floats:
        """Draw (n, 3) particles from the prior, in which phi is uniform."""
        p = self._parameters
        radius = rng.normal(p.mean_radius, p.radius_std, p.particles)
        while np.any(low := radius < p.min_radius):
            radius[low] = rng.normal(p.mean_radius, p.radius_std, int(low.sum()))
        angle = rng.normal(0.0, p.angle_std, p.particles)
        return np.column_stack([radius, angle, rng.uniform(-np.pi, np.pi, p.particles)])

    def log_prior(self, particles: Floats) -> Floats:
        """Return (n,) logarithms of the prior, up to a constant."""
        p = self._parameters
        radius, angle, _ = particles.T
        out = -0.5 * ((radius - p.mean_radius) / p.radius_std) ** 2
        out -= 0.5 * (angle / p.angle_std) ** 2
        possible = (radius >= p.min_radius) & (np.abs(angle) < np.pi / 2)
        return np.where(possible, out, -np.inf)

    def sums(self, particles: Floats, points: Floats, weights: Floats) -> Floats:
        """Return the (n, 3) sums of residuals; see `residual_sums`."""
        radius, angle, plane = particles.T
        shape = np.column_stack([1 / radius, np.sin(angle)])
        # The kernel needs ascending depths, but slices may come from deep to shallow.
        order = np.argsort(points[:, 2], kind="stable")
        u = deflections(shape, points[order, 2], self._rotations)
        return residual_sums(u, plane, points[order, :2], weights[order])

    def log_likelihood(self, sums: Floats, total: float) -> Floats:
        """Return (n,) logarithms of the likelihood, up to a constant."""
        if total <= 0:
            return np.zeros(len(sums))
        squares = about_best_origin(sums, total)
        return self._parameters.noise.log_likelihood(squares, total)


class ShapeParticleFilter:
    """Particle filter for static parameters, a `ShapeFilter`.

    Parameters
    ----------
    parameters
        Number of particles, prior and noise.
    """

    def __init__(self, parameters: ShapeParticleFilterParameters) -> None:
        self.parameters = parameters
        self._posterior = ShapePosterior(parameters)

    def begin(self, rng: np.random.Generator) -> ParticleBelief:
        """Return particles drawn from the prior, before any measurement."""
        particles = self._posterior.draw(rng)
        n = len(particles)
        return ParticleBelief(particles, np.zeros(n), np.zeros((n, 3)))

    def update(
        self, belief: ParticleBelief, point: Floats, rng: np.random.Generator
    ) -> ParticleBelief:
        """Weight the particles by one more measurement; resample and move them if necessary.

        Parameters
        ----------
        belief
            Belief before the measurement.
        point
            (3,) measured x, y and depth in I, in m.
        rng
            Generator for the resampling and the moves.
        """
        noise, posterior = self.parameters.noise, self._posterior
        weight = noise.independence
        if len(belief.points):
            paths, rotations = self.represent(belief, rng), self.parameters.rotations
            weight = noise.weight(point, paths, rotations, self._variance(belief))
        new_points, new_weights = point[np.newaxis], np.array([weight])
        sums = belief.sums + posterior.sums(belief.particles, new_points, new_weights)
        total = belief.total + weight
        gained = posterior.log_likelihood(sums, total)
        gained = gained - posterior.log_likelihood(belief.sums, belief.total)
        belief = ParticleBelief(
            belief.particles,
            belief.log_weights + gained,
            sums,
            np.vstack([belief.points, new_points]),
            np.append(belief.weights, weight),
        )
        share = belief.normalized_weights
        if 1 / np.sum(share**2) >= 0.5 * len(share):
            return belief
        return _move(_resample(belief, share, rng), posterior, self.parameters.moves, rng)

    def represent(self, belief: ParticleBelief, rng: np.random.Generator) -> ShapePaths:
        """Return the particles, each with its most probable origin."""
        return ShapePaths(
            parameters=belief.particles,
            origins=belief.sums[:, :2] / belief.total,
            weights=belief.normalized_weights,
            origin_variance=self._variance(belief) / belief.total,
        )

    def _variance(self, belief: ParticleBelief) -> float:
        """Return the learned variance of a measurement, in m^2."""
        squares = about_best_origin(belief.sums, belief.total)
        share = belief.normalized_weights
        usable = share > 0
        mean = float(share[usable] @ squares[usable])
        return self.parameters.noise.variance(mean, belief.total)


def _resample(belief: ParticleBelief, share: Floats, rng: np.random.Generator) -> ParticleBelief:
    """Resample systematically (Kitagawa 1996)."""
    n = len(share)
    positions = (rng.random() + np.arange(n)) / n
    chosen = np.minimum(np.searchsorted(np.cumsum(share), positions), n - 1)
    return replace(
        belief,
        particles=belief.particles[chosen],
        sums=belief.sums[chosen],
        log_weights=np.zeros(n),
    )


def _move(
    belief: ParticleBelief, posterior: ShapePosterior, moves: int, rng: np.random.Generator
) -> ParticleBelief:
    """Take Metropolis steps with the particles' own spread.

    The paths (theta_0, phi) and (-theta_0, phi + 180 deg) start in the same direction and bend to
    opposite sides. A few slices cannot distinguish them. The spread is measured, and the steps are
    taken, with all particles turned to one side. Every other step also proposes the other side.
    """
    particles, sums = belief.particles, belief.sums
    side, spread = _spread(particles)
    root = 2.38 / np.sqrt(3) * np.linalg.cholesky(spread)
    density = posterior.log_prior(particles) + posterior.log_likelihood(sums, belief.total)
    for number in range(moves):
        step = rng.normal(size=particles.shape) @ root.T
        step[:, 1] *= side
        proposed = particles + step
        if number % 2:
            flip = rng.random(len(particles)) < 0.5
            proposed[flip, 1] *= -1
            proposed[flip, 2] += np.pi
        else:
            flip = np.zeros(len(particles), bool)
        prior = posterior.log_prior(proposed)
        usable = np.isfinite(prior)
        # The likelihood of particles that the prior excludes is useless and not always defined.
        proposed[~usable] = particles[~usable]
        their_sums = posterior.sums(proposed, belief.points, belief.weights)
        their = prior + posterior.log_likelihood(their_sums, belief.total)
        accepted = usable & (np.log(rng.random(len(particles))) < their - density)
        particles = np.where(accepted[:, np.newaxis], proposed, particles)
        sums = np.where(accepted[:, np.newaxis], their_sums, sums)
        density = np.where(accepted, their, density)
        side = np.where(accepted & flip, -side, side)
    return replace(belief, particles=particles, sums=sums)


def _spread(particles: Floats) -> tuple[Floats, Floats]:
    """Return the (n,) sides of the particles, +-1, and the (3, 3) covariance with all on side 1."""
    plane = particles[:, 2]
    axis = 0.5 * np.angle(np.mean(np.exp(2j * plane)))
    side = np.where(np.cos(plane - axis) >= 0, 1.0, -1.0)
    turned = particles.copy()
    turned[:, 1] *= side
    turned[:, 2] = np.angle(side * np.exp(1j * (plane - axis)))
    spread = np.cov(turned.T) + np.diag([1e-3, 1e-6, 1e-6]) ** 2
    return side, spread
