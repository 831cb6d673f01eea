"""The true needle and its estimate, drawn in Meshcat."""

from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display.colours import HUB, MODE_COLOURS, STEEL, rgba
from sonoservo.systems.display.world.rod import Rod
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode


class NeedleView:
    """A whole needle: the part in the tissue, the part outside it, and the hub.

    Parameters
    ----------
    meshcat, path
        Meshcat to draw in, and the path of the drawing.
    length
        Length of the whole needle, in m.
    radius
        Radius of the needle, in m.
    """

    def __init__(self, *, meshcat: Meshcat, path: str, length: float, radius: float) -> None:
        self._length = length
        self._inside = Rod(
            meshcat=meshcat, path=f"{path}/inside", radius=radius, colour=rgba(STEEL), segments=6
        )
        self._outside = Rod(
            meshcat=meshcat, path=f"{path}/outside", radius=radius, colour=rgba(STEEL)
        )
        self._hub = Rod(meshcat=meshcat, path=f"{path}/hub", radius=4 * radius, colour=rgba(HUB))

    def draw(self, needle: Needle, X_WT: RigidTransform, time: float) -> None:
        """Draw a needle given in T; hide it if its position is unknown."""
        needle = needle.transformed(X_WT)
        axis = needle.shaft if needle else needle.aim
        if axis is None:
            for rod in (self._inside, self._outside, self._hub):
                rod.hide(time)
            return
        backward = axis[0] - axis[1]
        backward = backward / sum(backward**2) ** 0.5
        end = axis[0] + max(self._length - needle.length, 0.0) * backward
        if needle:
            self._inside.show(axis, time)
        else:
            self._inside.hide(time)
        self._outside.show([axis[0], end], time)
        self._hub.show([end, end + 0.025 * backward], time)


class EstimateView:
    """An estimated needle in the colour of its mode; hidden while searching.

    Parameters
    ----------
    meshcat, path
        Meshcat to draw in, and the path of the drawing.
    """

    def __init__(self, *, meshcat: Meshcat, path: str) -> None:
        self._rods = {
            mode: Rod(
                meshcat=meshcat, path=f"{path}/{mode}", radius=8e-4, colour=rgba(colour), segments=4
            )
            for mode, colour in MODE_COLOURS.items()
            if mode != TrackingMode.SEARCHING
        }

    def draw(self, estimate: NeedleEstimate, time: float) -> None:
        """Draw an estimate, or hide it if it has no curve."""
        for mode, rod in self._rods.items():
            if estimate.curve is not None and mode == estimate.mode:
                rod.show(estimate.curve.position([0.0, 0.25, 0.5, 0.75, 1.0]), time)
            else:
                rod.hide(time)
