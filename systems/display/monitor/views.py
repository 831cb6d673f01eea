"""Layout of the two planes through a needle on a monitor's screen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.planes import Plane, slice_planes
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_WIDTH, _HEIGHT = 0.70, 0.41  # maximum size of a picture on the screen
_LEFT, _TOPS = -0.73, (-0.455, 0.045)  # left and upper edges of the pictures


@dataclass(frozen=True)
class View:
    """A plane on a monitor's screen: the part that fits, its place and its scale.

    The screen is 1.6 wide and 1 high. Its frame M has its origin at the centre, X to the right, Y
    down and Z away.

    Parameters
    ----------
    plane
        Visible part of the slice, in P; its X points right and its Y down on the screen.
    origin
        (3,) origin of the coordinates in the plane, in P, in m; they run along the plane's X and Y.
    window
        (2, 2) coordinates of the upper left and lower right corners of the area that fits, in m.
    corner
        (2,) upper left corner of this area on the screen, in M.
    scale
        Length on the screen per m.
    """

    plane: Plane
    origin: Floats
    window: Floats
    corner: Floats
    scale: float

    def coordinates(self, p_P: Floats) -> Floats:
        """Return the (..., 2) coordinates in m of (..., 3) points in P, in m."""
        return (np.asarray(p_P) - self.origin) @ self.plane.X_PS.rotation().matrix()[:, :2]

    def on_screen(self, coordinates: Floats) -> Floats:
        """Return the (m, 2) points on the screen, in M, of (m, 2) coordinates."""
        return self.corner + self.scale * (coordinates - self.window[0])

    def in_probe(self, coordinates: Floats) -> Floats:
        """Return the (m, 3) points of the plane, in P, of (m, 2) coordinates."""
        X_PS = self.plane.X_PS
        offset = coordinates - self.coordinates(X_PS.translation())
        return X_PS.translation() + offset @ X_PS.rotation().matrix()[:, :2].T

    def holds(self, coordinates: Floats) -> NDArray[np.bool_]:
        """Return (...,) booleans: True for (..., 2) coordinates inside the window."""
        low, high = self.window
        return np.all((coordinates >= low) & (coordinates <= high), axis=-1)


def monitor_views(volume: Volume, curve: NeedleCurve | None = None) -> list[View]:
    """Return a monitor's views of the two orthogonal planes through the needle.

    See `slice_planes`. On the screen, X or else Z of P runs to the right, and the depth, or else Z,
    runs down. Coordinates are those of P seen in the plane. Along a needle that dips, zero is the
    point below the middle of the probe, or the middle of the slice from a dip of 60 deg on. Both
    pictures have the same scale, which depends on the size of the volume alone. Parts that do not
    fit are cut off.

    Parameters
    ----------
    volume
        Volume to slice.
    curve
        Estimated needle in W; without one, the planes are those of the probe.
    """
    size = volume.upper - volume.origin
    middle = 0.5 * (volume.upper + volume.origin)
    scale = min(_WIDTH / np.hypot(size[0], size[2]), _HEIGHT / max(size[1], size[2]))
    half = 0.5 * np.array([_WIDTH, _HEIGHT]) / scale
    views = []
    for top, slice_ in zip(_TOPS, slice_planes(volume, curve), strict=False):
        R = slice_.X_PS.rotation().matrix()
        right = 1.0 if R[0, 0] + 1e-6 * R[2, 0] >= 0 else -1.0
        down = 1.0 if R[1, 1] + R[2, 1] >= 0 else -1.0
        R = R * [right, down, right * down]
        centre = slice_.X_PS.translation()
        level = R[:, 0] * [1, 0, 1]
        if level @ level > 0.25:
            origin = R[:, 0] * (R[:, 0] @ centre - level @ centre / (level @ level))
            place = np.array([level @ middle / (level @ level), R[:, 1] @ middle])
        else:
            origin = R[:, 0] * (R[:, 0] @ centre)
            place = np.array([0.0, R[:, 1] @ middle])
        at = (centre - origin) @ R[:, :2]
        held = 0.5 * np.array([slice_.width, slice_.height])
        low, high = np.maximum(at - held, place - half), np.minimum(at + held, place + half)
        if (low < high).all():
            p_P = centre + R[:, :2] @ (0.5 * (low + high) - at)
            plane = Plane(RigidTransform(RotationMatrix(R), p_P), *(high - low))
            window = np.stack([place - half, place + half])
            views.append(View(plane, origin, window, np.array([_LEFT, top]), scale))
    return views
