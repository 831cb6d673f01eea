"""The axis of a needle: a polynomial fitted to voxels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.values import Immutable, NotFound, read_only


@dataclass(frozen=True, eq=False)
class Axis(Immutable):
    """A polynomial curve over its projection on a principal direction.

    Chatelain 2013, eq. 16, with the curvilinear coordinate in metres along the principal direction:
    C(a) = sum of c_i a^i for a = (v - origin) . k_0.

    Parameters
    ----------
    origin
        (3,) position where a = 0, in m.
    direction
        (3,) unit vector k_0.
    coefficients
        (n, 3) coefficients c_i; c_0 in m, c_1 without unit, c_2 in 1/m.
    """

    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    coefficients: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name in ("origin", "direction"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, (3,)))
        object.__setattr__(
            self, "coefficients", read_only(self.coefficients, "coefficients", (None, 3))
        )

    @property
    def order(self) -> int:
        """Number n of coefficients."""
        return len(self.coefficients)

    def abscissa(self, points: ArrayLike) -> NDArray[np.float64]:
        """(...) abscissae a in m of (..., 3) points: their projection on the direction."""
        return (np.asarray(points) - self.origin) @ self.direction

    def position(self, a: ArrayLike) -> NDArray[np.float64]:
        """(..., 3) positions in m at abscissae a in m."""
        a = np.asarray(a, dtype=float)
        powers = np.vander(a.ravel(), self.order, increasing=True)
        return (powers @ self.coefficients).reshape(*a.shape, 3)

    def distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """(...) approximate distances in m of (..., 3) points from the curve (eq. 18).

        For a straight axis they are exact.
        """
        points = np.asarray(points)
        return np.linalg.norm(points - self.position(self.abscissa(points)), axis=-1)

    def reversed(self) -> "Axis":
        """Return the same curve with the opposite direction."""
        signs = (-1.0) ** np.arange(self.order)
        return Axis(self.origin, -self.direction, self.coefficients * signs[:, np.newaxis])


def axis_through(points: NDArray[np.float64]) -> Axis | NotFound:
    """Axis of order n through n points, (n, 3) in m, along the line from the first to the last."""
    chord = points[-1] - points[0]
    length = float(np.linalg.norm(chord))
    if not length > 0:
        return NotFound("the first and the last point coincide")
    direction = chord / length
    a = (points - points[0]) @ direction
    if np.min(np.abs(np.diff(np.sort(a)))) <= 1e-9 * length:
        return NotFound("two points share an abscissa")
    coefficients = np.linalg.solve(np.vander(a, increasing=True), points - points[0])
    coefficients[0] += points[0]
    return Axis(points[0], direction, coefficients)


@dataclass(frozen=True, eq=False)
class AxisFit(Immutable):
    """A least-squares axis with what it knows of its own precision.

    Parameters
    ----------
    axis
        The fitted axis; its origin is the points' weighted centroid.
    normal_inverse
        (n, n) inverse of the weighted normal matrix, for weights that sum to one.
    scatter
        (3, 3) weighted covariance of the residuals, in m^2; zero along the direction.
    """

    axis: Axis
    normal_inverse: NDArray[np.float64]
    scatter: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = self.axis.order
        object.__setattr__(
            self, "normal_inverse", read_only(self.normal_inverse, "normal_inverse", (n, n))
        )
        object.__setattr__(self, "scatter", read_only(self.scatter, "scatter", (3, 3)))

    def reversed(self) -> "AxisFit":
        """Return the same fit with the opposite direction."""
        signs = (-1.0) ** np.arange(self.axis.order)
        return AxisFit(
            self.axis.reversed(), self.normal_inverse * np.outer(signs, signs), self.scatter
        )

    def covariance(self, a: ArrayLike, independent: float) -> NDArray[np.float64]:
        """(3m, 3m) covariance in m^2 of the m positions at abscissae a, extrapolation included.

        Parameters
        ----------
        a
            (m,) abscissae in m.
        independent
            Number of independent observations that the points amount to: voxels within one beam
            width repeat each other.
        """
        powers = np.vander(np.asarray(a, dtype=float), self.axis.order, increasing=True)
        shape: NDArray[np.float64] = powers @ self.normal_inverse @ powers.T / independent
        return np.asarray(np.kron(shape, self.scatter), dtype=np.float64)


def assess_axis(axis: Axis, points: NDArray[np.float64], weights: NDArray[np.float64]) -> AxisFit:
    """Return an axis as it is, with the precision of a fit to as many points, scattered like these.

    Parameters
    ----------
    axis
        That passes through no less than n of the points.
    points
        (m, 3) in m.
    weights
        (m,) not negative.
    """
    w = weights / weights.sum()
    a = axis.abscissa(points)
    powers = np.vander(a, axis.order, increasing=True)
    residuals = points - axis.position(a)
    return AxisFit(
        axis,
        np.linalg.inv((powers * w[:, np.newaxis]).T @ powers),
        (residuals * w[:, np.newaxis]).T @ residuals,
    )


def fit_axis(
    points: NDArray[np.float64], weights: NDArray[np.float64], order: int
) -> AxisFit | NotFound:
    """Weighted least-squares axis through points.

    The direction is the principal one of the weighted covariance (total least squares); for order
    2 the axis is that closed form. For a higher order the displacement across the direction is
    regressed on powers of the abscissa.

    Parameters
    ----------
    points
        (m, 3) in m.
    weights
        (m,) not negative.
    order
        n, 2 or more.

    Returns
    -------
    The fit, or `NotFound` where the points do not determine one.
    """
    total = weights.sum()
    if len(points) < order or not total > 0:
        return NotFound(f"{len(points)} points do not determine an axis of order {order}")
    w = weights / total
    origin = w @ points
    centred = points - origin
    covariance = (centred * w[:, np.newaxis]).T @ centred
    values, vectors = np.linalg.eigh(covariance)
    if not values[2] > 1e-18 or values[2] - values[1] < 1e-9 * values[2]:
        return NotFound("the points have no principal direction")
    direction = vectors[:, 2]
    a = centred @ direction
    powers = np.vander(a, order, increasing=True)
    # Scaled to unit length, so that powers of millimetres stay well conditioned.
    scale = np.sqrt(values[2]) ** -np.arange(order)
    scaled = powers * scale
    normal = (scaled * w[:, np.newaxis]).T @ scaled
    if np.linalg.cond(normal) > 1e10:
        return NotFound("the points' abscissae do not determine the axis")
    inverse = np.linalg.inv(normal)
    across = centred - np.outer(a, direction)
    coefficients = scale[:, np.newaxis] * (inverse @ ((scaled * w[:, np.newaxis]).T @ across))
    residuals = across - powers @ coefficients
    residuals -= np.outer(residuals @ direction, direction)
    coefficients[0] += origin
    coefficients[1] += direction
    return AxisFit(
        Axis(origin, direction, coefficients),
        inverse * np.outer(scale, scale),
        (residuals * w[:, np.newaxis]).T @ residuals,
    )
