"""The true needle and its estimate, drawn in Meshcat."""

from pydrake.geometry import Meshcat, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.colours import HUB, MODE_COLOURS, STEEL, TRUTH, rgba
from sonoservo.systems.display.shapes import circle, tubes
from sonoservo.systems.display.world.parts import Rod, Switch
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode

# Smallest radius of a drawn needle, and radius of the ball at its tip, in m.
_VISIBLE, _BALL = 1.3e-3, 2.2e-3
RING = 6e-3
"""Radius of the ring around what was estimated, in m: clear of the true tip."""


class NeedleView:
    """A whole needle: the part in the tissue with its tip, the part outside it, and the hub."""

    def __init__(self, *, meshcat: Meshcat, path: str, length: float, radius: float) -> None:
        self._length = length
        radius = max(radius, _VISIBLE)
        self._meshcat, self._tip = meshcat, f"{path}/tip"
        meshcat.SetObject(self._tip, Sphere(_BALL), rgba((1, 1, 1)))
        self._tip_switch = Switch(meshcat=meshcat, path=self._tip)
        self._inside = Rod(
            meshcat=meshcat, path=f"{path}/inside", radius=radius, colour=rgba(TRUTH), segments=6
        )
        self._outside = Rod(
            meshcat=meshcat, path=f"{path}/outside", radius=radius, colour=rgba(STEEL)
        )
        self._hub = Rod(meshcat=meshcat, path=f"{path}/hub", radius=3 * radius, colour=rgba(HUB))

    def draw(self, needle: Needle, X_WT: RigidTransform, time: float) -> None:
        """Draw a needle given in T; hide it if its position is unknown."""
        needle = needle.transformed(X_WT)
        axis = needle.shaft if needle else needle.aim
        if axis is None:
            for rod in (self._inside, self._outside, self._hub):
                rod.hide(time)
            self._tip_switch.set(False, time)
            return
        backward = axis[0] - axis[1]
        backward = backward / sum(backward**2) ** 0.5
        end = axis[0] + max(self._length - needle.length, 0.0) * backward
        self._tip_switch.set(bool(needle), time)
        if needle:
            self._inside.show(axis, time)
            self._meshcat.SetTransform(self._tip, RigidTransform(needle.tip), time)
        else:
            self._inside.hide(time)
        self._outside.show([axis[0], end], time)
        self._hub.show([end, end + 0.025 * backward], time)


class EstimateView:
    """An estimated needle in the colour of its mode, with a ring around its tip."""

    def __init__(self, *, meshcat: Meshcat, path: str) -> None:
        self._meshcat, self._path = meshcat, path
        self._rods = {}
        for mode, colour in MODE_COLOURS.items():
            if mode == TrackingMode.SEARCHING:
                continue
            below = f"{path}/{mode}"
            self._rods[mode] = Rod(
                meshcat=meshcat, path=below, radius=8e-4, colour=rgba(colour), segments=4
            )
            meshcat.SetObject(f"{below}/ring", tubes([circle(RING)], 8e-4), rgba(colour))
            for part in ("ring", *(f"{number}/unit" for number in range(4))):
                meshcat.SetProperty(f"{below}/{part}/<object>", "material.depthTest", False)
                meshcat.SetProperty(f"{below}/{part}/<object>", "renderOrder", 1.0)

    def draw(self, estimate: NeedleEstimate, time: float) -> None:
        """Draw an estimate, or hide it if it has no curve."""
        for mode, rod in self._rods.items():
            if estimate.curve is not None and mode == estimate.mode:
                rod.show(estimate.curve.position([0.0, 0.25, 0.5, 0.75, 1.0]), time)
                R = RotationMatrix.MakeFromOneVector(estimate.curve.direction, 2)
                X = RigidTransform(R, estimate.curve.tip)
                self._meshcat.SetTransform(f"{self._path}/{mode}/ring", X, time)
            else:
                rod.hide(time)
