"""Confidence ellipsoid of a position."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.world.rod import Switch
from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.requirements import require


def confidence_ellipsoid(
    covariance: ArrayLike, probability: float = 0.95
) -> tuple[RotationMatrix, NDArray[np.float64]]:
    """Return half axes in m, rotation and centre of an ellipsoid of confidence.

    It holds a share of a normal distribution with a (3, 3) covariance in m^2.
    """
    require(0 < probability < 1, "probability", probability, "between 0 and 1")
    variances, axes = np.linalg.eigh(np.asarray(covariance, dtype=float))
    if np.linalg.det(axes) < 0:
        axes = axes * [1, 1, -1]
    half_axes = np.sqrt(np.maximum(variances, 0) * squared_distance(probability, 3))
    return RotationMatrix(axes), half_axes


class EllipsoidView:
    """An ellipsoid of uncertainty in Meshcat, posed and stretched."""

    def __init__(self, *, meshcat: Meshcat, path: str, colour: Rgba) -> None:
        self._meshcat, self._path = meshcat, path
        meshcat.SetObject(f"{path}/unit", Sphere(1.0), colour)
        # It is smaller than the needle's diameter, so the needle would hide it.
        meshcat.SetProperty(f"{path}/unit/<object>", "material.depthTest", False)
        meshcat.SetProperty(f"{path}/unit/<object>", "renderOrder", 1.0)
        self._switch = Switch(meshcat=meshcat, path=path)

    def show(self, centre: ArrayLike, covariance: ArrayLike, time: float) -> None:
        """Show the 95 % ellipsoid of a mean in m and a (3, 3) covariance in m^2, both in W."""
        R, half_axes = confidence_ellipsoid(covariance)
        position = np.asarray(centre, dtype=float)
        self._meshcat.SetTransform(self._path, RigidTransform(R, position), time)
        scale = np.maximum(half_axes, 1e-6).tolist()
        self._meshcat.SetProperty(f"{self._path}/unit", "scale", scale, time)
        self._switch.set(True, time)

    def hide(self, time: float) -> None:
        """Hide the ellipsoid from a time on, in s."""
        self._switch.set(False, time)
