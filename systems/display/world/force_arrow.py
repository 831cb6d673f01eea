"""A force as an arrow with its value."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, MeshcatCone
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.colours import FORCE, rgba
from sonoservo.systems.display.world.label import Label
from sonoservo.systems.display.world.rod import Rod

_METRE_PER_NEWTON = 0.02
_RADIUS, _HEAD = 2e-3, 0.012
_LEAST = 0.05
"""In N: less is not drawn."""


class ForceArrow:
    """An arrow as long as a force is large, 20 mm a newton, and its value beyond its tail.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    R_WLabel
        How the value is turned: X along it, -Y upwards.
    """

    def __init__(self, *, meshcat: Meshcat, path: str, R_WLabel: RotationMatrix) -> None:
        self._meshcat, self._path, self._R_WLabel = meshcat, path, R_WLabel
        self._shaft = Rod(meshcat=meshcat, path=f"{path}/arrow", radius=_RADIUS, colour=rgba(FORCE))
        cone = MeshcatCone(_HEAD, 2.5 * _RADIUS, 2.5 * _RADIUS)
        meshcat.SetObject(f"{path}/arrow/head", cone, rgba(FORCE))
        self._value = Label(meshcat=meshcat, path=f"{path}/value", height=0.016)

    def show(self, force: float, point: ArrayLike, outward: ArrayLike, time: float) -> None:
        """Show a force that presses on a surface.

        Parameters
        ----------
        force
            In N.
        point
            (3,) where the arrow ends, on the surface, in W, in m.
        outward
            (3,) unit vector from the surface to where the force comes from.
        time
            In s.
        """
        if not force > _LEAST:
            self._shaft.hide(time)
            self._value.show("", time)
            return
        point, outward = np.asarray(point, dtype=float), np.asarray(outward, dtype=float)
        neck = point + _HEAD * outward
        tail = neck + _METRE_PER_NEWTON * force * outward
        self._shaft.show([neck, tail], time)
        # Drake's cone has its apex at the origin and widens along Z.
        X_WHead = RigidTransform(RotationMatrix.MakeFromOneVector(outward, 2), point)
        self._meshcat.SetTransform(f"{self._path}/arrow/head", X_WHead, time)
        X_WLabel = RigidTransform(self._R_WLabel, tail + 0.014 * outward)
        self._meshcat.SetTransform(f"{self._path}/value", X_WLabel, time)
        self._value.show(f"{force:.1f} N", time, (0, 0, 0), FORCE)
