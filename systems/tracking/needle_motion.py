"""Motion model of a needle between two volumes: constant velocity with white acceleration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
)

Floats = float | NDArray[np.float64]


@dataclass(kw_only=True)
class NeedleMotionParameters(Bounded):
    """Spectral densities of the needle's white acceleration, in m^2/s^3.

    Parameters
    ----------
    insertion
        Density of the tip's acceleration along the needle. A point at the relative abscissa u has u
        times the tip's acceleration.
    body
        Density of the acceleration of the needle as a whole, in every direction, as the tissue
        moves.
    bending
        Density of the independent acceleration of each control point, in every direction.
    """

    insertion: NotNegative = 5e-5
    body: NotNegative = 2e-6
    bending: NotNegative = 2e-7

    def density(self, curve: NeedleCurve) -> NDArray[np.float64]:
        """Return the (3n, 3n) spectral density of the stacked control points' acceleration."""
        return acceleration_density(curve, self.insertion, self.body, self.bending)


def acceleration_density(
    curve: NeedleCurve, insertion: Floats, body: Floats, bending: Floats
) -> NDArray[np.float64]:
    """Return the density as `NeedleMotionParameters.density`, or (m, 3n, 3n) for (m, 1, 1) each."""
    n = curve.order
    along = np.outer(np.linspace(0, 1, n), curve.direction).ravel()
    density = insertion * np.outer(along, along) + body * np.tile(np.eye(3), (n, n))
    return np.asarray(density + bending * np.eye(3 * n))


def constant_velocity(
    dt: float, density: NDArray[np.float64], *, fades: float = np.inf
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return transition A and noise Q of a constant-velocity model (Chatelain 2013, eqs. 8, 6).

    ``density`` is that of the white acceleration, or the densities of several models, each with
    a noise of its own; the velocity falls to 1/e in ``fades`` s.
    """
    d = density.shape[-1]
    A: NDArray[np.float64] = np.eye(2 * d)
    kept = np.exp(-dt / fades)
    A[:d, d:] = (dt if kept == 1 else fades * (1 - kept)) * np.eye(d)
    A[d:, d:] = kept * np.eye(d)
    Q: NDArray[np.float64] = np.empty((*density.shape[:-2], 2 * d, 2 * d))
    Q[..., :d, :d], Q[..., d:, d:] = dt**3 / 3 * density, dt * density
    Q[..., :d, d:] = Q[..., d:, :d] = dt**2 / 2 * density
    return A, Q
