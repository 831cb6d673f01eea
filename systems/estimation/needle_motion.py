"""Motion of a needle between two volumes: constant velocity, white acceleration."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.requirements import require_not_negative


@dataclass(kw_only=True)
class NeedleMotionParameters:
    """Spectral densities of the needle's white acceleration, in m^2/s^3.

    Parameters
    ----------
    insertion
        Density along the needle, at the tip; a point at abscissa u has u times the tip's
        acceleration.
    body
        Density of the needle as a whole, in every direction: the tissue moves.
    bending
        Density of each control point by itself, in every direction.
    """

    insertion: float = 5e-5
    body: float = 2e-6
    bending: float = 2e-7

    def __post_init__(self) -> None:
        require_not_negative(insertion=self.insertion, body=self.body, bending=self.bending)

    def density(self, curve: NeedleCurve) -> NDArray[np.float64]:
        """(3n, 3n) spectral density of the stacked control points' acceleration."""
        n = curve.order
        u = np.linspace(0, 1, n)
        k = curve.direction
        return (
            self.insertion * np.kron(np.outer(u, u), np.outer(k, k))
            + self.body * np.kron(np.ones((n, n)), np.eye(3))
            + self.bending * np.eye(3 * n)
        )


def constant_velocity(
    dt: float, density: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Transition A and noise Q of a constant-velocity model (Chatelain 2013, eqs. 8 and 6).

    Parameters
    ----------
    dt
        Time step in s.
    density
        (d, d) spectral density of the white acceleration.

    Returns
    -------
    A, Q
        (2d, 2d) each.
    """
    identity = np.eye(len(density))
    A: NDArray[np.float64] = np.kron(np.array([[1.0, dt], [0.0, 1.0]]), identity)
    Q: NDArray[np.float64] = np.kron(np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), density)
    return A, Q
