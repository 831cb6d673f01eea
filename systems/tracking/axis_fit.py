"""Least-squares fit of a needle's axis to voxels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.immutable import NotFound, seal
from sonoservo.systems.tracking.axis import Axis


@dataclass(frozen=True, eq=False)
class AxisFit:
    """A least-squares axis with the quantities that give its precision."""

    axis: Axis
    """The fitted axis; its origin is the points' weighted centroid."""
    normal_inverse: NDArray[np.float64]
    """(n, n) inverse of the weighted normal matrix, for weights that sum to one."""
    scatter: NDArray[np.float64]
    """(3, 3) weighted covariance of the residuals, in m^2; zero along the direction."""

    def covariance(self, a: ArrayLike, independent: float) -> NDArray[np.float64]:
        """Return the (3m, 3m) covariance in m^2 of m positions on the axis, extrapolated or not.

        ``independent`` is the number of independent observations to which the points amount: fewer
        than there are, as voxels within one beam width repeat each other.
        """
        powers = np.vander(np.asarray(a, dtype=float), self.axis.order, increasing=True)
        shape: NDArray[np.float64] = powers @ self.normal_inverse @ powers.T / independent
        return np.asarray(np.kron(shape, self.scatter), dtype=np.float64)


# Rows are filled by element: numba takes seconds to compile the checks of an array's assignment to
# a slice.
@njit(cache=True, nogil=True, error_model="numpy")
def least_squares(  # pragma: no cover - compiled
    coordinates: Any, weights: Any, order: int, towards: Any
) -> Any:
    """Fit an axis of order 2 or 3 to (3, m) coordinates; core of `fit_axis` and the consensus.

    Return a flag that is true if they determine one, the (2 + n, 3) origin, direction and
    coefficients, the (n, n) inverse of the normal matrix, and the (3, 3) scatter.
    """
    # In the scaled abscissa t, of mean 0 and variance 1, the normal matrix of 1 and t is the
    # identity. That of 1, t and t^2 follows from the skewness and the kurtosis of t.
    axis, inverse, scatter = np.zeros((2 + order, 3)), np.eye(order), np.zeros((3, 3))
    x, y, z = coordinates[0], coordinates[1], coordinates[2]
    total, used = weights.sum(), 0
    for i in range(len(weights)):
        used += int(weights[i] > 0)
    if used < order or not total > 0:
        return False, axis, inverse, scatter
    ox = oy = oz = 0.0
    for i in range(len(x)):
        w = weights[i]
        ox += w * x[i]
        oy += w * y[i]
        oz += w * z[i]
    ox, oy, oz = ox / total, oy / total, oz / total
    xx = yy = zz = xy = yz = zx = 0.0
    for i in range(len(x)):
        w, dx, dy, dz = weights[i], x[i] - ox, y[i] - oy, z[i] - oz
        xx += w * dx * dx
        yy += w * dy * dy
        zz += w * dz * dz
        xy += w * dx * dy
        yz += w * dy * dz
        zx += w * dz * dx
    scatter[0, 0], scatter[1, 1], scatter[2, 2] = xx / total, yy / total, zz / total
    scatter[0, 1] = scatter[1, 0] = xy / total
    scatter[1, 2] = scatter[2, 1] = yz / total
    scatter[0, 2] = scatter[2, 0] = zx / total
    values, vectors = np.linalg.eigh(scatter)
    variance = values[2]
    if not variance > 1e-18 or variance - values[1] < 1e-9 * variance:
        return False, axis, inverse, scatter
    axis[0, 0], axis[0, 1], axis[0, 2] = ox, oy, oz
    k = vectors[:, 2].copy()
    if np.sum(k * towards) < 0:
        k *= -1
    axis[1, 0], axis[1, 1], axis[1, 2] = k
    scatter -= variance * np.outer(k, k)
    if order == 3:
        scale = 1 / np.sqrt(variance)
        skewness = kurtosis = qx = qy = qz = 0.0
        for i in range(len(x)):
            w, dx, dy, dz = weights[i] / total, x[i] - ox, y[i] - oy, z[i] - oz
            a = dx * k[0] + dy * k[1] + dz * k[2]
            t = a * scale
            skewness += w * t**3
            kurtosis += w * t**4
            qx += w * t**2 * (dx - a * k[0])
            qy += w * t**2 * (dy - a * k[1])
            qz += w * t**2 * (dz - a * k[2])
        determinant = kurtosis - 1 - skewness**2
        if determinant < 1e-9:
            return False, axis, inverse, scatter
        # The displacement across the direction has no mean and no slope, but a bend.
        bend = np.array([qx, qy, qz])
        last = np.array([-1.0, -skewness, 1.0]) / determinant
        inverse += determinant * np.outer(last, last)
        inverse[2, 2] = last[2]
        scatter -= last[2] * np.outer(bend, bend)
        units = scale ** np.arange(3)
        for i in range(3):
            for j in range(3):
                axis[2 + i, j] = last[i] * units[i] * bend[j]
        inverse *= np.outer(units, units)
    else:
        inverse[1, 1] = 1 / variance
    for c in range(3):
        axis[2, c] += axis[0, c]
        axis[3, c] += k[c]
    return True, axis, inverse, scatter


def fit_axis(
    points: NDArray[np.float64],
    weights: NDArray[np.float64],
    order: int,
    towards: ArrayLike = (0.0, 0.0, 0.0),
) -> AxisFit | NotFound:
    """Fit an axis of order 2 or 3 to (m, 3) points by weighted least squares.

    It follows the principal direction of the weighted covariance, turned to the side of
    ``towards``. For order 3, the displacement across it is regressed on powers of the abscissa.
    """
    towards = np.array(towards, float)  # writable, as the consensus has it: one kernel serves both
    solution = least_squares(np.ascontiguousarray(points.T), weights, order, towards)
    return as_fit(solution, len(points))


def assess_axis(axis: Axis, points: NDArray[np.float64], weights: NDArray[np.float64]) -> AxisFit:
    """Return an axis unchanged, with the precision of a fit to points that scatter like these."""
    w = weights / weights.sum()
    a = axis.abscissa(points)
    powers = np.vander(a, axis.order, increasing=True)
    residuals = points - axis.position(a)
    return AxisFit(
        axis,
        np.linalg.inv((powers * w[:, np.newaxis]).T @ powers),
        (residuals * w[:, np.newaxis]).T @ residuals,
    )


def as_fit(solution: Any, count: int) -> AxisFit | NotFound:
    """Convert the result of `least_squares` for ``count`` points."""
    determined, axis, normal_inverse, scatter = solution
    if not determined:
        return NotFound(f"{count} points do not determine an axis of order {len(axis) - 2}")
    axis = seal(axis)
    return AxisFit(Axis(axis[0], axis[1], axis[2:]), seal(normal_inverse), seal(scatter))
