"""Particle filter for the shape of a needle whose parameters do not change.

It replaces the filter of Carriere 2016, section IV. That filter chooses the best particle for each
point separately and draws all particles towards these, so their spread vanishes for any data. Here
every particle is weighted by the joint likelihood of all cross-sections. When few particles carry
most of the weight, they are resampled and moved by Metropolis steps that leave the posterior
unchanged (Chopin 2002, "A sequential particle filter method for static models").
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from sonoservo.systems.shape.shape_filter import ShapePaths
from sonoservo.systems.shape.shape_posterior import (
    Moments,
    ShapeParticleFilterParameters,
    ShapePosterior,
    WanderFits,
    WanderParameters,
)
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.needle_shape import bicycle_paths

Floats = NDArray[np.float64]

_IMPOSSIBLE = 1e-4
"""Probability below which a level of the tissue's shift is dropped."""


@dataclass(frozen=True, eq=False)
class ParticleBelief(Immutable):
    """Particles, the measurements so far, and what was learned of them; see `ShapePosterior`."""

    particles: Floats
    """(n, 5) R in m, theta_0 and phi in rad, ln alpha and ln beta."""
    log_weights: Floats
    """(n,) log weights of the particles, up to a constant."""
    sums: Floats
    moments: Moments
    fits: WanderFits | None
    variance: float
    """Learned variance of x and of y of a measurement, in m^2."""
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) measurements in I, in m."""
    weights: Floats = field(default_factory=lambda: np.zeros(0))
    log_evidence: float = 0.0

    @property
    def normalized_weights(self) -> Floats:
        """(n,) weights of the particles, with a sum of 1."""
        weights = np.exp(self.log_weights - self.log_weights.max())
        return weights / weights.sum()


class _Filter:
    """Particle filter for static parameters in tissue whose shift has a known level."""

    def __init__(self, parameters: ShapeParticleFilterParameters) -> None:
        self.parameters = parameters
        self._posterior = ShapePosterior(parameters)

    def begin(self, rng: np.random.Generator) -> ParticleBelief:
        """Return particles drawn from the prior, before any measurement."""
        particles = self._posterior.draw(rng)
        points, weights = np.zeros((0, 3)), np.zeros(0)
        return ParticleBelief(
            particles,
            log_weights=np.zeros(len(particles)),
            sums=self._posterior.sums(particles, points, weights),
            moments=self._posterior.moments(points, weights),
            fits=None,
            variance=self.parameters.noise.std**2,
        )

    def update(
        self, belief: ParticleBelief, point: Floats, rng: np.random.Generator
    ) -> ParticleBelief:
        """Weight the particles by (3,) x, y and depth in I, in m; resample and move them."""
        posterior, before = self._posterior, np.zeros(len(belief.particles))
        if belief.fits is not None:
            before = posterior.log_likelihood(belief.fits, belief.moments)
        points = np.vstack([belief.points, point])
        weights = np.append(belief.weights, self._weight(belief, point, rng))
        moments = posterior.moments(points, weights)
        sums = belief.sums + posterior.sums(belief.particles, points[-1:], weights[-1:])
        fits = posterior.fit(belief.particles, sums, moments, belief.variance)
        gained = posterior.log_likelihood(fits, moments) - before
        evidence = float(logsumexp(gained, b=belief.normalized_weights))
        belief = replace(
            belief,
            log_weights=belief.log_weights + gained,
            log_evidence=belief.log_evidence + evidence,
            sums=sums,
            moments=moments,
            fits=fits,
            points=points,
            weights=weights,
        )
        share = belief.normalized_weights
        if 1 / np.sum(share**2) < 0.5 * len(share):
            belief = _resample(belief, share, rng)
            belief = _move(belief, posterior, self.parameters.moves, rng)
            share = belief.normalized_weights
        assert belief.fits is not None
        usable = share > 0
        squares = float(share[usable] @ belief.fits.squares[usable])
        return replace(belief, variance=self.parameters.noise.variance(squares, moments.total))

    def represent(self, belief: ParticleBelief, rng: np.random.Generator) -> ShapePaths:
        """Return the particles, each with its most probable origin and a draw of its wander."""
        assert belief.fits is not None
        wander, origins = self._posterior.sample(
            belief.particles, belief.sums, belief.moments, belief.fits, belief.variance, rng
        )
        return ShapePaths(
            parameters=belief.particles[:, :3],
            origins=origins,
            weights=belief.normalized_weights,
            origin_variance=belief.variance / belief.moments.total,
            wander=wander,
            wander_length=self.parameters.wander.length,
        )

    def _weight(self, belief: ParticleBelief, point: Floats, rng: np.random.Generator) -> float:
        """Return the weight of a measurement; see `MeasurementNoise.weight`."""
        noise = self.parameters.noise
        if not len(belief.points):
            return noise.independence
        paths = self.represent(belief, rng)
        at = (
            paths.origins
            + bicycle_paths(paths.parameters, point[2:], self.parameters.rotations)[:, 0]
        )
        modes = self._posterior.design(point[2:])[0, self._posterior.wandering]
        at += np.matmul(modes, paths.wander)
        spread = paths.origin_variance + noise.shift_std**2
        return noise.weight(point[:2], at, paths.weights, spread, belief.variance)


@dataclass(frozen=True, eq=False)
class ShiftedBeliefs(Immutable):
    """Beliefs about the needle for each level of the tissue's shift that is still possible."""

    levels: tuple[ParticleBelief, ...]
    numbers: tuple[int, ...]

    @property
    def shares(self) -> Floats:
        """Probability of each level."""
        evidence = np.array([each.log_evidence for each in self.levels])
        weights = np.exp(evidence - evidence.max())
        return np.asarray(weights / weights.sum())

    @property
    def particles(self) -> Floats:
        """(n, 5) particles of all levels."""
        return np.concatenate([each.particles for each in self.levels])

    @property
    def normalized_weights(self) -> Floats:
        """(n,) weights of all particles, with a sum of 1."""
        levels = zip(self.shares, self.levels, strict=True)
        return np.concatenate([share * each.normalized_weights for share, each in levels])


class ShapeParticleFilter:
    """Particle filters for static parameters, one for each level of the tissue's shift.

    Tissue that breathes shifts neighbouring slices alike, which would look like a needle that bends
    to and fro. Each filter integrates out a shift of its level, and the evidence weighs the levels.
    """

    def __init__(self, parameters: ShapeParticleFilterParameters) -> None:
        self.parameters = parameters
        self._filters = tuple(
            _Filter(replace(parameters, noise=replace(parameters.noise, shift_std=each)))
            for each in parameters.shift_stds
        )

    def begin(self, rng: np.random.Generator) -> ShiftedBeliefs:
        """Return particles drawn from the prior, before any measurement."""
        levels = tuple(each.begin(rng) for each in self._filters)
        return ShiftedBeliefs(levels, tuple(range(len(levels))))

    def update(
        self, belief: ShiftedBeliefs, point: Floats, rng: np.random.Generator
    ) -> ShiftedBeliefs:
        """Weight all particles by (3,) x, y and depth in I, in m; impossible levels are dropped."""
        levels = zip(belief.numbers, belief.levels, strict=True)
        after = [self._filters[k].update(each, point, rng) for k, each in levels]
        shares = ShiftedBeliefs(tuple(after), belief.numbers).shares
        kept = [k for k, share in enumerate(shares) if share > _IMPOSSIBLE]
        return ShiftedBeliefs(tuple(after[k] for k in kept), tuple(belief.numbers[k] for k in kept))

    def represent(self, belief: ShiftedBeliefs, rng: np.random.Generator) -> ShapePaths:
        """Return the particles, each with its most probable origin and a draw of its wander."""
        levels = zip(belief.numbers, belief.levels, strict=True)
        paths = [self._filters[k].represent(each, rng) for k, each in levels]
        return ShapePaths(
            parameters=np.concatenate([each.parameters for each in paths]),
            origins=np.concatenate([each.origins for each in paths]),
            weights=belief.normalized_weights,
            origin_variance=float(belief.shares @ [each.origin_variance for each in paths]),
            wander=np.concatenate([each.wander for each in paths]),
            wander_length=self.parameters.wander.length,
        )

    def learned_wander(self, belief: ShiftedBeliefs) -> WanderParameters:
        """Return the wander's prior for the next needle in the tissue: the posterior's moments."""
        share, amplitudes = belief.normalized_weights, belief.particles[:, 3:]
        mean = share @ amplitudes
        spread = np.sqrt(share @ (amplitudes - mean) ** 2)
        return replace(
            self.parameters.wander,
            amplitude=float(np.exp(mean[0])),
            spread=float(spread[0]),
            across=float(np.exp(mean[1])),
            across_spread=float(spread[1]),
        )


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
    belief: ParticleBelief,
    posterior: ShapePosterior,
    moves: int,
    rng: np.random.Generator,
) -> ParticleBelief:
    """Take Metropolis steps with the particles' own spread.

    The paths (theta_0, phi) and (-theta_0, phi + 180 deg) start in the same direction and bend to
    opposite sides. A few slices cannot distinguish them. The spread is measured, and the steps are
    taken, with all particles turned to one side. Every other step also proposes the other side.
    """
    particles, sums = belief.particles, belief.sums
    moments, variance = belief.moments, belief.variance
    side, spread = _spread(particles)
    root = 2.38 / np.sqrt(len(spread)) * np.linalg.cholesky(spread)
    prior = posterior.log_prior(particles)
    fits = posterior.fit(particles, sums, moments, variance)
    likelihood = posterior.log_likelihood(fits, moments)
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
        their_prior = posterior.log_prior(proposed)
        usable = np.isfinite(their_prior)
        # The likelihood of particles that the prior excludes is useless and not always defined.
        proposed[~usable] = particles[~usable]
        their_sums = posterior.sums(proposed, belief.points, belief.weights)
        fits = posterior.fit(proposed, their_sums, moments, variance)
        theirs = posterior.log_likelihood(fits, moments)
        gain = their_prior + theirs - prior - likelihood
        accepted = usable & (np.log(rng.random(len(particles))) < gain)
        particles = np.where(accepted[:, np.newaxis], proposed, particles)
        sums = np.where(accepted[:, np.newaxis], their_sums, sums)
        prior = np.where(accepted, their_prior, prior)
        likelihood = np.where(accepted, theirs, likelihood)
        side = np.where(accepted & flip, -side, side)
    fits = posterior.fit(particles, sums, moments, variance)
    return replace(belief, particles=particles, sums=sums, fits=fits)


def _spread(particles: Floats) -> tuple[Floats, Floats]:
    """Return the (n,) sides of the particles, +-1, and the (5, 5) covariance with all on side 1."""
    plane = particles[:, 2]
    axis = 0.5 * np.angle(np.mean(np.exp(2j * plane)))
    side = np.where(np.cos(plane - axis) >= 0, 1.0, -1.0)
    turned = particles.copy()
    turned[:, 1] *= side
    turned[:, 2] = np.angle(side * np.exp(1j * (plane - axis)))
    spread = np.cov(turned.T) + np.diag([1e-3, 1e-6, 1e-6, 1e-3, 1e-3]) ** 2
    return side, spread
