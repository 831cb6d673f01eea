"""Prior and likelihood of a needle's shape, with wander, shift, and noise that is learned."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.shape.shape_filter import (
    MAX_PARTICLES,
    ShapeEstimatorParameters,
)
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.curvature_wander import WanderModes, wander_modes
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.needle_shape import path_statistics
from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
    Positive,
    PositiveInt,
    check_bounds,
    require,
    require_within,
)

Floats = NDArray[np.float64]


@dataclass(kw_only=True)
class MeasurementNoise:
    """Noise of measured cross-sections, with a level that is learned from their scatter.

    The variance has an inverse gamma distribution. Integration over it leaves a likelihood that
    depends on the sum of squares only. Scattered slices therefore widen the uncertainty.

    Parameters
    ----------
    std
        Expected standard deviation of x and of y, in m.
    confidence
        Number of measurements to which the expectation is equivalent.
    independence
        Share of a slice's information that its neighbours do not already contain. It is below 1 if
        errors are correlated from slice to slice, as they are through the speckle of overlapping
        slices.
    outlier
        Distance of a measurement from its prediction, in standard deviations, beyond which its
        weight falls in inverse proportion (Huber).
    shift_std, shift_length
        Standard deviation in m of a shift of the tissue along X and along Y, and the distance in m
        along the path over which it persists; 0 for none.
    """

    std: Positive = 0.12e-3
    confidence: Positive = 10.0
    independence: float = 0.9
    outlier: Positive = 3.0
    shift_std: NotNegative = 0.0
    shift_length: Positive = 6e-3

    def __post_init__(self) -> None:
        check_bounds(self)
        allowed = "above 0 and at most 1"
        require(0 < self.independence <= 1, "independence", self.independence, allowed)

    def log_likelihood(self, squares: Floats, total: float) -> Floats:
        """Return (n,) logarithms of the likelihood of squared residuals, up to a constant."""
        degrees = self.confidence + max(2 * total - 2, 0.0)
        return -0.5 * degrees * np.log(self._scale + squares)

    def variance(self, squares: float, total: float) -> float:
        """Return the learned variance of x and of y, in m^2; see `log_likelihood`."""
        return (self._scale + squares) / (self.confidence + max(2 * total - 2, 0.0))

    def weight(
        self, point: Floats, paths: Floats, weights: Floats, origin_variance: float, variance: float
    ) -> float:
        """Return the weight of a measured (2,) x and y in I, in m; an unexpected one has less.

        ``paths`` are the (n, 2) x and y there before the measurement, ``weights`` theirs; the
        variances are those of x and of y, of each path's origin and of a measurement, in m^2.
        """
        mean, covariance = path_statistics(paths[:, np.newaxis], weights)
        innovation = point - mean[0]
        spread = covariance[0] + (origin_variance + variance) * np.eye(2)
        distance = float(np.sqrt(innovation @ np.linalg.solve(spread, innovation)))
        return self.independence * min(1.0, self.outlier / max(distance, 1e-9))

    @property
    def _scale(self) -> float:
        return self.confidence * self.std**2


_SHIFT_SHARE = 0.99
"""Share of the variance of the tissue's shift that its modes represent."""


@dataclass(kw_only=True)
class WanderParameters(Bounded):
    """Prior of the curvature's wander, as a Gaussian process along the path.

    Parameters
    ----------
    amplitude
        Median of the log-normal distribution of the wander's standard deviation, relative to the
        mean curvature; 0 for a constant curvature.
    spread
        Standard deviation of the logarithm of that amplitude.
    across, across_spread
        The same for the curvature out of the plane, which also stands for a plane that drifts and
        for a rotation that is some degrees off.
    most
        Largest amplitude, relative to the mean curvature. Without a limit, tissue that shifts with
        the breath would count as a needle that bends to and fro.
    length
        Standard deviation in m of the Gaussian that smooths white noise to such a curvature.
    """

    amplitude: NotNegative = 0.1
    spread: Positive = 0.6
    across: Positive = 0.1
    across_spread: Positive = 0.6
    most: Positive = 0.5
    length: Positive = 0.02


def combined_wander(
    prior: WanderParameters, learnt: Sequence[WanderParameters]
) -> WanderParameters:
    """Return the wander's distribution after several needles in the same tissue."""

    def combined(median: str, spread: str) -> dict[str, float]:
        """Add up what each needle tells, as precisions of the logarithm."""
        first = getattr(prior, spread) ** -2
        precision, weighted = first, first * np.log(getattr(prior, median))
        for each in learnt:
            theirs = getattr(each, spread) ** -2
            gained = max(theirs - first, 0.0)
            middle = np.log(getattr(prior, median))
            if gained:
                told = theirs * np.log(getattr(each, median)) - first * middle
                # A needle that says little must not say something extreme.
                middle = np.clip(told / gained, middle - 3, middle + 3)
            precision, weighted = precision + gained, weighted + gained * middle
        return {median: float(np.exp(weighted / precision)), spread: float(precision**-0.5)}

    along, across = combined("amplitude", "spread"), combined("across", "across_spread")
    return replace(prior, **along, **across)


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
    wander
        Prior of the curvature's wander along the path.
    shift_stds
        Levels of the tissue's shift in m, of equal probability; see `MeasurementNoise`. Each has
        particles of its own.
    """

    particles: int = 500
    min_radius: float = 0.2
    moves: PositiveInt = 3
    noise: MeasurementNoise = field(default_factory=MeasurementNoise)
    wander: WanderParameters = field(default_factory=WanderParameters)
    shift_stds: list[float] = field(default_factory=lambda: [0.0, 0.2e-3, 0.5e-3])

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.shift_stds) > 0, "shift_stds", self.shift_stds, "one level or more")
        require_within("particles", self.particles, 50, MAX_PARTICLES)
        self._require_min_radius(self.min_radius)


@dataclass(frozen=True, eq=False)
class Moments(Immutable):
    """Weighted moments of the measurements in m and of the k modes at their depths."""

    points: Floats
    """(k + 1, 2) sums of x and y times a constant and each mode."""
    square: float
    """Sum of their squares, in m^2."""
    modes: Floats
    """(k + 1, k + 1) sums of products of the constant and the modes."""

    @property
    def total(self) -> float:
        """Sum of the weights."""
        return float(self.modes[0, 0])


class WanderFits(NamedTuple):
    """Fit of the wander for each of n particles; a first axis is in the plane and across it."""

    squares: Floats
    """(n,) weighted squared residuals about the best origin and wander, plus the prior's part, in
    m^2."""
    log_determinant: Floats
    """(n,) logarithm of the factor by which the wander widens the data's distribution."""
    rotation: Floats
    """(k, k) rotation that makes the modes uncorrelated."""
    mean: Floats
    """(2, n, k) rotated coefficients, in 1/m."""
    shrinkage: Floats
    """Their variances over that of a measurement, in 1/m^4."""


@lru_cache(maxsize=16)
def shift_modes(depth: float, length: float) -> WanderModes:
    """Return the principal modes of a shift with the covariance exp(-d^2 / (2 length^2))."""
    depths = np.linspace(0, depth, max(int(np.ceil(3 * depth / length)), 2) + 1)
    apart = (depths[:, np.newaxis] - depths) / length
    values, vectors = np.linalg.eigh(np.exp(-0.5 * apart**2))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    number = int(np.searchsorted(np.cumsum(values), _SHIFT_SHARE * values.sum())) + 1
    return WanderModes(depths, vectors[:, :number] * np.sqrt(values[:number]))


class ShapePosterior:
    """Prior and likelihood of (n, 5) particles R, theta_0, phi, ln alpha, ln beta."""

    def __init__(self, parameters: ShapeParticleFilterParameters) -> None:
        self._parameters = p = parameters
        self._rotations = np.array(p.rotations, dtype=float)
        self._modes = wander_modes(p.depth, p.rotations, p.wander.length)
        self._shifts = shift_modes(p.depth, p.noise.shift_length) if p.noise.shift_std else None
        self._constant = p.wander.amplitude == 0
        self._log_median = np.log([p.wander.amplitude or 1.0, p.wander.across])
        self._log_most = float(np.log(p.wander.most))
        self._log_spread = np.array([p.wander.spread, p.wander.across_spread])

    def draw(self, rng: np.random.Generator) -> Floats:
        """Draw (n, 5) particles from the prior, in which phi is uniform."""
        p = self._parameters
        radius = rng.normal(p.mean_radius, p.radius_std, p.particles)
        while np.any(low := radius < p.min_radius):
            radius[low] = rng.normal(p.mean_radius, p.radius_std, int(low.sum()))
        angle = rng.normal(0.0, p.angle_std, p.particles)
        plane = rng.uniform(-np.pi, np.pi, p.particles)
        amplitudes = rng.normal(self._log_median, self._log_spread, (p.particles, 2))
        amplitudes = np.minimum(amplitudes, self._log_most)
        return np.column_stack([radius, angle, plane, amplitudes])

    def log_prior(self, particles: Floats) -> Floats:
        """Return (n,) logarithms of the prior, up to a constant."""
        p = self._parameters
        radius, angle = particles[:, 0], particles[:, 1]
        out = -0.5 * ((radius - p.mean_radius) / p.radius_std) ** 2
        out -= 0.5 * (angle / p.angle_std) ** 2
        out -= 0.5 * (((particles[:, 3:] - self._log_median) / self._log_spread) ** 2).sum(axis=1)
        possible = (radius >= p.min_radius) & (np.abs(angle) < np.pi / 2)
        possible &= (particles[:, 3:] <= self._log_most).all(axis=1)
        return np.where(possible, out, -np.inf)

    def design(self, depths: Floats) -> Floats:
        """Return (m, k + 1 + s) constant 1, modes of wander and shift at (m,) depths in m."""
        columns = [np.ones((len(depths), 1))]
        if not self._constant:
            columns.append(self._modes.at(depths))
        if self._shifts is not None:
            columns.append(self._shifts.at(depths))
        return np.hstack(columns)

    @property
    def wandering(self) -> slice:
        """Columns of the `design` that are modes of the wander."""
        return slice(1, 1 if self._constant else 1 + len(self._modes))

    def moments(self, points: Floats, weights: Floats) -> Moments:
        """Return the moments of (m, 3) measured points with (m,) weights."""
        design = self.design(points[:, 2])
        weighted = design * weights[:, np.newaxis]
        square = float(weights @ (points[:, :2] ** 2).sum(axis=1))
        return Moments(weighted.T @ points[:, :2], square, weighted.T @ design)

    def sums(self, particles: Floats, points: Floats, weights: Floats) -> Floats:
        """Return (n, k + 4) weighted sums of u^2, u x, u y, u, u times each mode; u: deflection."""
        shape = np.column_stack([1 / particles[:, 0], np.sin(particles[:, 1])])
        # The kernel needs ascending depths, but slices may come from deep to shallow.
        order = np.argsort(points[:, 2], kind="stable")
        points, weights = points[order], weights[order]
        u = deflections(shape, points[:, 2], self._rotations)
        factors = np.hstack([points[:, :2], self.design(points[:, 2])])
        products = u @ (factors * weights[:, np.newaxis])
        return np.column_stack([(u * u) @ weights, products])

    def log_likelihood(self, fits: WanderFits, moments: Moments) -> Floats:
        """Return (n,) logarithms of the likelihood, up to a constant."""
        likelihood = self._parameters.noise.log_likelihood(fits.squares, moments.total)
        return likelihood - fits.log_determinant

    def sample(
        self,
        particles: Floats,
        sums: Floats,
        moments: Moments,
        fits: WanderFits,
        variance: float,
        rng: np.random.Generator,
    ) -> tuple[Floats, Floats]:
        """Draw the wander of each particle's path, given the measurements and their `fit`."""
        sums, moments, _ = self._without_shift(sums, moments, variance)
        drawn = np.sqrt(variance * fits.shrinkage) * rng.normal(size=fits.mean.shape)
        along, across = (fits.mean + drawn) @ fits.rotation.T
        cosine, sine = np.cos(particles[:, 2:3]), np.sin(particles[:, 2:3])
        wander = np.stack([cosine * along - sine * across, sine * along + cosine * across], axis=-1)
        first = moments.points[0] - sums[:, 3:4] * np.hstack([cosine, sine])
        origins = (first - np.tensordot(moments.modes[0, 1:], wander, (0, 1))) / moments.total
        return wander, origins

    def fit(self, particles: Floats, sums: Floats, moments: Moments, variance: float) -> WanderFits:
        """Fit origin and wander of each particle to all measurements, of a ``variance`` in m^2."""
        sums, moments, shift_determinant = self._without_shift(sums, moments, variance)
        # The origin has a flat prior; its integral centres everything.
        middle = moments.modes[1:, 0] / moments.total
        strength, rotation = np.linalg.eigh(
            moments.modes[1:, 1:] - np.outer(middle, moments.modes[0, 1:])
        )
        strength = np.maximum(strength, 0.0)
        points = rotation.T @ (moments.points[1:] - np.outer(middle, moments.points[0]))
        paths = (sums[:, 4:] - sums[:, 3:4] * middle) @ rotation
        # Sums of the residuals in the plane and across it, in which the paths have no part.
        along = np.column_stack([np.cos(particles[:, 2]), np.sin(particles[:, 2])])
        across = along @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        products = np.stack([along @ points.T - paths, across @ points.T])
        first = np.stack([along @ moments.points[0] - sums[:, 3], across @ moments.points[0]])
        squares = moments.square - 2 * (sums[:, 1:3] * along).sum(axis=1) + sums[:, 0]
        squares = squares - (first**2).sum(axis=0) / moments.total
        # Prior variance of the coefficients relative to that of a measurement. The wander of a
        # needle that bends unusually much is limited, or correlated noise would look like one.
        p = self._parameters
        radius = np.maximum(particles[:, :1], p.mean_radius - 1.5 * p.radius_std)
        curvature = (np.exp(particles[:, 3:]) / radius).T
        ratio = (curvature**2 / variance)[..., np.newaxis]
        widened = 1 + ratio * strength
        shrinkage = ratio / widened
        mean = shrinkage * products
        squares = np.maximum(squares - (mean * products).sum(axis=(0, 2)), 0.0)
        return WanderFits(
            squares=np.where(np.isfinite(squares), squares, np.inf),
            log_determinant=0.5 * np.log(widened).sum(axis=(0, 2)) + shift_determinant,
            rotation=rotation,
            mean=mean,
            shrinkage=shrinkage,
        )

    def _without_shift(
        self, sums: Floats, moments: Moments, variance: float
    ) -> tuple[Floats, Moments, float]:
        """Return sums and moments with the tissue's shift integrated out, and its determinant."""
        k = self.wandering.stop
        std = self._parameters.noise.shift_std
        if self._shifts is None:
            return sums, moments, float(np.log(moments.total or 1.0))
        modes, points = moments.modes, moments.points
        ridge = variance / std**2
        inner = modes[k:, k:] + ridge * np.eye(len(modes) - k)
        solved = np.linalg.solve(inner, np.hstack([modes[k:, :k], points[k:]]))
        at_modes, at_points = solved[:, :k], solved[:, k:]
        kept = modes[:k, :k] - modes[:k, k:] @ at_modes
        reduced = Moments(
            points[:k] - modes[:k, k:] @ at_points,
            moments.square - float((points[k:] * at_points).sum()),
            kept,
        )
        own = sums[:, 3 + k :]
        square = sums[:, 0] - (own * np.linalg.solve(inner, own.T).T).sum(axis=1)
        sums = np.column_stack(
            [square, sums[:, 1:3] - own @ at_points, sums[:, 3 : 3 + k] - own @ at_modes]
        )
        determinant = np.linalg.slogdet(inner / ridge)[1] + np.log(max(reduced.total, 1e-300))
        return sums, reduced, float(determinant)
