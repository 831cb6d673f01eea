"""Bayesian least squares for the shape of a needle, the baseline of the particle filters.

Gauss-Newton steps find the most probable origin, plane, first angle and radius given all
cross-sections. The uncertainty is the normal distribution with the same curvature at that maximum
(Laplace's approximation).
"""

from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.shape.shape_filter import ShapeEstimatorParameters, ShapePaths
from sonoservo.systems.shape.shape_posterior import MeasurementNoise
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.needle_shape import bicycle_paths
from sonoservo.systems.signals.requirements import at_least

Floats = NDArray[np.float64]

_STEPS = 5
_PLANE_STD = np.pi / np.sqrt(3)
"""Standard deviation in rad of an unknown angle, which is uniform from -pi to pi."""


@dataclass(kw_only=True)
class ShapeLeastSquaresParameters(ShapeEstimatorParameters):
    """Parameters of the least squares, in addition to those of every shape estimator.

    Parameters
    ----------
    samples
        Number of paths that represent the distribution of the shape.
    min_radius
        Smallest radius in m.
    noise
        Noise of the measured cross-sections.
    """

    samples: Annotated[int, at_least(20)] = 200
    min_radius: float = 0.2
    noise: MeasurementNoise = field(default_factory=MeasurementNoise)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._require_min_radius(self.min_radius)


@dataclass(frozen=True, eq=False)
class FittedShape(Immutable):
    """Most probable x and y of the origin in m, phi and theta_0 in rad, and R in m."""

    parameters: Floats
    covariance: Floats
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) measured x, y and depth in I, in m."""
    weights: Floats = field(default_factory=lambda: np.zeros(0))


class ShapeLeastSquares:
    """Bayesian least-squares fit, a `ShapeFilter`."""

    def __init__(self, parameters: ShapeLeastSquaresParameters) -> None:
        self.parameters = parameters
        self._rotations = np.array(parameters.rotations, dtype=float)
        p = parameters
        self._prior_mean = np.array([0.0, 0.0, 0.0, 0.0, p.mean_radius])
        self._prior_precision = np.array(
            [0.0, 0.0, _PLANE_STD**-2, p.angle_std**-2, p.radius_std**-2]
        )

    def begin(self, rng: np.random.Generator) -> FittedShape:
        """Return the prior, with an unknown origin."""
        p = self.parameters
        std = np.array([1.0, 1.0, _PLANE_STD, p.angle_std, p.radius_std])
        return FittedShape(self._prior_mean, np.diag(std**2))

    def update(self, belief: FittedShape, point: Floats, rng: np.random.Generator) -> FittedShape:
        """Fit again with one more measurement, (3,) x, y and depth in I, in m."""
        noise = self.parameters.noise
        weight = noise.independence
        if len(belief.points):
            paths = self.represent(belief, rng)
            at = bicycle_paths(paths.parameters, point[2:], self.parameters.rotations)[:, 0]
            weight = noise.weight(
                point[:2], paths.origins + at, paths.weights, 0.0, self._variance(belief)
            )
        points = np.vstack([belief.points, point])
        order = np.argsort(points[:, 2], kind="stable")
        points, weights = points[order], np.append(belief.weights, weight)[order]
        fits = [self._fit(start, points, weights) for start in self._starts(belief, points)]
        _, parameters, covariance = min(fits, key=lambda fit: fit[0])
        return FittedShape(parameters, covariance, points, weights)

    def _starts(self, fitted: FittedShape, points: Floats) -> list[Floats]:
        """Return the last fit and the straight line, each bent to either side, as starting points.

        Paths that start in one direction and bend to opposite sides are two separate minima.
        """
        starts = [fitted.parameters]
        if len(points) == 1:
            starts = [np.concatenate([points[0, :2], self._prior_mean[2:]])]
        elif points[-1, 2] - points[0, 2] < 0.03:
            x, y, z = points.T
            (slope_x, slope_y), (at_x, at_y) = np.polyfit(z, np.stack([x, y], axis=1), 1)
            plane, angle = np.arctan2(slope_y, slope_x), np.arctan(np.hypot(slope_x, slope_y))
            starts.append(np.array([at_x, at_y, plane, angle, self.parameters.mean_radius]))
        return starts + [
            start * [1, 1, 1, -1, 1] + np.array([0, 0, np.pi, 0, 0]) for start in starts
        ]

    def _fit(self, start: Floats, points: Floats, weights: Floats) -> tuple[float, Floats, Floats]:
        """Return cost, parameters and covariance at the minimum closest to a start."""
        noise = self.parameters.noise
        parameters, precision = start.copy(), self._prior_precision
        total = float(weights.sum())
        for _ in range(_STEPS):
            residual, jacobian = self._linearized(parameters, points)
            weighted = np.tile(weights, 2)
            squares = float(weighted @ residual**2)
            variance = noise.variance(squares, total)
            from_prior = self._prior_mean - parameters
            from_prior[2] = 0.0
            hessian = (jacobian.T * weighted) @ jacobian / variance + np.diag(precision)
            gradient = jacobian.T @ (weighted * residual) / variance + precision * from_prior
            parameters = parameters + np.linalg.solve(hessian, gradient)
            parameters[3] = np.clip(parameters[3], -1.0, 1.0)
            parameters[4] = max(parameters[4], self.parameters.min_radius)
        residual, jacobian = self._linearized(parameters, points)
        squares = float(np.tile(weights, 2) @ residual**2)
        hessian = (jacobian.T * np.tile(weights, 2)) @ jacobian / noise.variance(squares, total)
        apart = (self._prior_mean - parameters)[3:]
        cost = -float(noise.log_likelihood(np.array(squares), total))
        cost += 0.5 * float(precision[3:] @ apart**2)
        covariance: Any = np.linalg.inv(hessian + np.diag(precision))
        return cost, parameters, covariance

    def _linearized(self, parameters: Floats, points: Floats) -> tuple[Floats, Floats]:
        """Return (2m,) residuals, x before y, in m, and (2m, 5) derivatives of the prediction."""
        x, y, plane, angle, radius = parameters
        curvature, sine = 1 / radius, np.sin(angle)
        dk, ds = 1e-4, 1e-6
        shapes = np.array([[curvature, sine], [curvature + dk, sine], [curvature, sine + ds]])
        u, u_curved, u_turned = deflections(shapes, points[:, 2], self._rotations)
        du_radius = (u_curved - u) / dk * -(curvature**2)
        du_angle = (u_turned - u) / ds * np.cos(angle)
        c, s, zero, one = np.cos(plane), np.sin(plane), np.zeros(len(u)), np.ones(len(u))
        jacobian = np.vstack(
            [
                np.stack([one, zero, -s * u, c * du_angle, c * du_radius], axis=1),
                np.stack([zero, one, c * u, s * du_angle, s * du_radius], axis=1),
            ]
        )
        return np.concatenate([points[:, 0] - x - c * u, points[:, 1] - y - s * u]), jacobian

    def _variance(self, fitted: FittedShape) -> float:
        """Return the learned variance of a measurement, in m^2."""
        residual, _ = self._linearized(fitted.parameters, fitted.points)
        squares = float(np.tile(fitted.weights, 2) @ residual**2)
        return self.parameters.noise.variance(squares, float(fitted.weights.sum()))

    def represent(self, belief: FittedShape, rng: np.random.Generator) -> ShapePaths:
        """Return paths drawn from the fit."""
        draws = rng.standard_normal((self.parameters.samples // 2, 5))
        # Pairs about the middle make the mean equal to the fit.
        draws = np.vstack([draws, -draws]) @ np.linalg.cholesky(belief.covariance).T
        x, y, plane, angle, radius = (belief.parameters + draws).T
        radius = np.maximum(radius, self.parameters.min_radius)
        angle = np.clip(angle, -1.0, 1.0)
        return ShapePaths(
            parameters=np.column_stack([radius, angle, plane]),
            origins=np.column_stack([x, y]),
            weights=np.full(len(radius), 1 / len(radius)),
        )
