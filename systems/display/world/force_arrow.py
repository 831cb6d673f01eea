"""A force drawn as an arrow with its value."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Meshcat, MeshcatCone
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.colours import FORCE, rgba
from sonoservo.systems.display.world.label import Label
from sonoservo.systems.display.world.rod import Rod

_METRE_PER_NEWTON = 0.02
_RADIUS, _HEAD = 2e-3, 0.012
_LEAST = 0.05  # Smallest force that is drawn, in N


class ForceArrow:
    """An arrow at the probe's face with the contact force in N beside it."""

    def __init__(self, *, meshcat: Meshcat, path: str, R_WLabel: RotationMatrix) -> None:
        self._meshcat, self._path, self._R_WLabel = meshcat, path, R_WLabel
        self._shaft = Rod(meshcat=meshcat, path=f"{path}/arrow", radius=_RADIUS, colour=rgba(FORCE))
        cone = MeshcatCone(_HEAD, 2.5 * _RADIUS, 2.5 * _RADIUS)
        meshcat.SetObject(f"{path}/arrow/head", cone, rgba(FORCE))
        self._value = Label(meshcat=meshcat, path=f"{path}/value", height=0.016)

    def show(self, force: float, point: ArrayLike, outward: ArrayLike, time: float) -> None:
        """Show a force in N at a point in W, along the body's outward normal, from a time on."""
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
