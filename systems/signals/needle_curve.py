"""Needle as a polynomial curve through control points."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, Shape, seal
from sonoservo.systems.signals.requirements import require


@lru_cache
def _points_to_coefficients(order: int) -> NDArray[np.floating]:
    """Return the inverse of the Vandermonde matrix at the control points' i / (order - 1)."""
    return np.linalg.inv(np.vander(np.linspace(0, 1, order), increasing=True))


@dataclass(frozen=True, eq=False)
class NeedleCurve(Immutable):
    """A polynomial curve through its control points, entry first, tip last.

    In Chatelain 2013 the filter's state contains points (eq. 3), and the localizer uses
    coefficients (eq. 16). Here the points are primary. They lie at abscissae u = i / (n - 1), from
    0 at the entry to 1 at the tip, and the coefficients follow from them.
    """

    control_points: Annotated[NDArray[np.float64], Shape(None, 3)]
    """Positions in m. The curve is straight for two of them and bent for three."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(2 <= self.order <= 4, "control_points", self.order, "2 to 4 points")

    @property
    def order(self) -> int:
        """Number n of control points."""
        return len(self.control_points)

    @property
    def entry(self) -> NDArray[np.float64]:
        """(3,) first control point, in m."""
        return self.control_points[0]

    @property
    def tip(self) -> NDArray[np.float64]:
        """(3,) last control point, in m."""
        return self.control_points[-1]

    @cached_property
    def chord(self) -> float:
        """Distance from entry to tip, in m."""
        return float(np.linalg.norm(self.tip - self.entry))

    @cached_property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector k from entry to tip, the principal direction k_0 of the paper."""
        return seal((self.tip - self.entry) / max(self.chord, np.finfo(float).tiny))

    @property
    def coefficients(self) -> NDArray[np.float64]:
        """(3, n) matrix H of Chatelain 2013, eq. 16, for abscissae u from 0 to 1."""
        return (_points_to_coefficients(self.order) @ self.control_points).T

    def position(self, u: ArrayLike) -> NDArray[np.float64]:
        """Return (..., 3) positions in m at abscissae u (eq. 16), extrapolated beyond [0, 1]."""
        u = np.asarray(u, dtype=float)
        return np.vander(u.ravel(), self.order, increasing=True).reshape(*u.shape, -1) @ (
            self.coefficients.T
        )

    def tangent(self, u: float) -> NDArray[np.float64]:
        """Return the (3,) unit vector along the curve at abscissa u."""
        powers = np.arange(1, self.order)
        derivative = self.coefficients[:, 1:] @ (powers * float(u) ** (powers - 1))
        return derivative / np.linalg.norm(derivative)

    def transformed(self, X: RigidTransform) -> "NeedleCurve":
        """Return the curve expressed in another frame."""
        return NeedleCurve(X.multiply(self.control_points.T).T)
