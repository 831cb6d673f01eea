"""Bayesian least squares for the shape of a needle: the baseline of the particle filters.

The most probable origin, plane, first angle and radius given all cross-sections, by Gauss-Newton
steps, and the normal distribution of the same curvature there (Laplace's approximation).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.shape_parameters import ShapeEstimatorParameters
from sonoservo.systems.estimation.shape_posterior import MeasurementNoise
from sonoservo.systems.signals.bicycle_paths import deflections
from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]

_STEPS = 5
_PLANE_DEVIATION = np.pi / np.sqrt(3)
"""Of an angle that may be any, in rad."""


@dataclass(kw_only=True)
class ShapeLeastSquaresParameters(ShapeEstimatorParameters):
    """Of the least squares, besides what every shape estimator knows.

    Parameters
    ----------
    samples
        Paths that stand for the distribution of the shape.
    min_radius
        No needle bends more than this, in m.
    noise
        Of the measured cross-sections.
    """

    samples: int = 200
    min_radius: float = 0.2
    noise: MeasurementNoise = field(default_factory=MeasurementNoise)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.samples >= 20, "samples", self.samples, "at least 20")
        require(
            0 < self.min_radius < self.mean_radius,
            "min_radius",
            self.min_radius,
            "above 0, below mean_radius",
        )


@dataclass(frozen=True, eq=False)
class FittedShape(Immutable):
    """The most probable parameters.

    Parameters
    ----------
    parameters
        (5,) x and y of the origin in m, phi and theta_0 in rad, R in m.
    covariance
        (5, 5) of these.
    points, weights
        (m, 3) measured x, y and depth in I, in m, and (m,).
    """

    parameters: Floats
    covariance: Floats
    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    weights: Floats = field(default_factory=lambda: np.zeros(0))


class ShapeFit:
    """The fit for given parameters of the estimator."""

    def __init__(self, parameters: ShapeLeastSquaresParameters) -> None:
        self._parameters = parameters
        self._rotations = np.array(parameters.rotations, dtype=float)
        p = parameters
        self._prior_mean = np.array([0.0, 0.0, 0.0, 0.0, p.mean_radius])
        self._prior_precision = np.array(
            [0.0, 0.0, _PLANE_DEVIATION**-2, p.angle_std**-2, p.radius_std**-2]
        )

    def begin(self) -> FittedShape:
        """Return the prior; the origin is unknown."""
        deviation = np.array(
            [1.0, 1.0, _PLANE_DEVIATION, self._parameters.angle_std,
             self._parameters.radius_std]
        )  # fmt: skip
        return FittedShape(self._prior_mean, np.diag(deviation**2))

    def update(self, fitted: FittedShape, point: Floats, weight: float) -> FittedShape:
        """Fit again with one more measurement.

        Parameters
        ----------
        fitted
            Before.
        point, weight
            (3,) measured x, y and depth in I, in m, and its weight from 0 to 1.
        """
        points = np.vstack([fitted.points, point])
        order = np.argsort(points[:, 2], kind="stable")
        points, weights = points[order], np.append(fitted.weights, weight)[order]
        fits = [self._fit(start, points, weights) for start in self._starts(fitted, points)]
        _, parameters, covariance = min(fits, key=lambda fit: fit[0])
        return FittedShape(parameters, covariance, points, weights)

    def _starts(self, fitted: FittedShape, points: Floats) -> list[Floats]:
        """Return where to start: the last fit and the straight line, each bent to either side.

        Paths that start in one direction and bend to opposite sides are two minima.
        """
        starts = [fitted.parameters]
        if len(points) == 1:
            starts = [np.concatenate([points[0, :2], self._prior_mean[2:]])]
        elif points[-1, 2] - points[0, 2] < 0.03:
            x, y, z = points.T
            (slope_x, slope_y), (at_x, at_y) = np.polyfit(z, np.stack([x, y], axis=1), 1)
            plane, angle = np.arctan2(slope_y, slope_x), np.arctan(np.hypot(slope_x, slope_y))
            starts.append(np.array([at_x, at_y, plane, angle, self._parameters.mean_radius]))
        return starts + [
            start * [1, 1, 1, -1, 1] + np.array([0, 0, np.pi, 0, 0]) for start in starts
        ]

    def _fit(self, start: Floats, points: Floats, weights: Floats) -> tuple[float, Floats, Floats]:
        """Cost, parameters and covariance at the minimum next to a start."""
        noise = self._parameters.noise
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
            parameters[4] = max(parameters[4], self._parameters.min_radius)
        residual, jacobian = self._linearized(parameters, points)
        squares = float(np.tile(weights, 2) @ residual**2)
        hessian = (jacobian.T * np.tile(weights, 2)) @ jacobian / noise.variance(squares, total)
        apart = (self._prior_mean - parameters)[3:]
        cost = -float(noise.log_likelihood(np.array(squares), total))
        cost += 0.5 * float(precision[3:] @ apart**2)
        covariance: Any = np.linalg.inv(hessian + np.diag(precision))
        return cost, parameters, covariance

    def _linearized(self, parameters: Floats, points: Floats) -> tuple[Floats, Floats]:
        """(2m,) residuals, x before y, in m, and (2m, 5) derivatives of the prediction."""
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

    def variance(self, fitted: FittedShape) -> float:
        """Learned variance of a measurement, in m^2."""
        residual, _ = self._linearized(fitted.parameters, fitted.points)
        squares = float(np.tile(fitted.weights, 2) @ residual**2)
        return self._parameters.noise.variance(squares, float(fitted.weights.sum()))

    def sample(self, fitted: FittedShape, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """(n, 3) R, theta_0, phi and (n, 2) origins of paths drawn from the fit."""
        draws = rng.standard_normal((self._parameters.samples // 2, 5))
        # In pairs about the middle, so that their mean is the fit.
        draws = np.vstack([draws, -draws]) @ np.linalg.cholesky(fitted.covariance).T
        x, y, plane, angle, radius = (fitted.parameters + draws).T
        radius = np.maximum(radius, self._parameters.min_radius)
        angle = np.clip(angle, -1.0, 1.0)
        return np.column_stack([radius, angle, plane]), np.column_stack([x, y])
