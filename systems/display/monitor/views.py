"""How the two planes through a needle lie on a monitor's screen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.planes import Plane, slice_planes
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

_WIDTH, _HEIGHT = 0.70, 0.41  # of a picture on the screen, at most
_LEFT, _TOPS = -0.73, (-0.455, 0.045)  # of the pictures


@dataclass(frozen=True)
class View:
    """A plane as a monitor shows it: the part that fits, and how it lies on the screen.

    The screen's frame M has its origin in the middle of the screen, which is 1.6 wide and 1 high,
    X to the right, Y down and Z away.

    Parameters
    ----------
    plane
        The part of the slice that is shown, in P; its X is right and its Y down on the screen.
    origin
        (3,) of the coordinates in the plane, in P, in m; they run along the plane's own X and Y.
    window
        (2, 2) coordinates, in m, of the left upper and the right lower corner of what would fit.
    corner
        (2,) the same left upper corner on the screen, in M.
    scale
        Length on the screen per m.
    """

    plane: Plane
    origin: Floats
    window: Floats
    corner: Floats
    scale: float

    def coordinates(self, p_P: Floats) -> Floats:
        """(..., 2) coordinates, in m, of (..., 3) points in P."""
        return (np.asarray(p_P) - self.origin) @ self.plane.X_PS.rotation().matrix()[:, :2]

    def on_screen(self, coordinates: Floats) -> Floats:
        """(m, 2) points on the screen, in M, of (m, 2) coordinates."""
        return self.corner + self.scale * (coordinates - self.window[0])

    def in_probe(self, coordinates: Floats) -> Floats:
        """(m, 3) points of the plane, in P, of (m, 2) coordinates."""
        X_PS = self.plane.X_PS
        offset = coordinates - self.coordinates(X_PS.translation())
        return X_PS.translation() + offset @ X_PS.rotation().matrix()[:, :2].T

    def holds(self, coordinates: Floats) -> NDArray[np.bool_]:
        """(...,) whether (..., 2) coordinates are in the window."""
        low, high = self.window
        return np.all((coordinates >= low) & (coordinates <= high), axis=-1)


def monitor_views(volume: Volume, curve: NeedleCurve | None = None) -> list[View]:
    """Return how a monitor shows the two orthogonal planes through the needle.

    See `slice_planes`. On the screen, X or else Z of P runs to the right, and the depth, or else Z,
    runs down. Coordinates are those of P seen in the plane; along a needle that dips, zero is where
    it is below the middle of the probe (from 60 deg on, the middle of the slice). Both pictures
    have the same scale, which depends on the size of the volume alone. What does not fit is cut
    off.

    Parameters
    ----------
    volume
        To cut.
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
