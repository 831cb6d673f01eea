"""A screen in the world that shows the slices upright."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Meshcat
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.colours import PANEL, rgba
from sonoservo.systems.display.textured_quads import gltf_textured_quads
from sonoservo.systems.display.world.film import Film
from sonoservo.systems.signals.planes import Plane
from sonoservo.systems.signals.volume import Volume

_THICKNESS = 0.004
_IN_FRONT = -0.5 * _THICKNESS - 0.002
_MARGIN = 0.004


class Screen:
    """A dark panel with one slice above the other.

    The beam's axis stays at a fixed place in both pictures, and so does the probe's face in the
    first one. Only the contents of the pictures move.

    Parameters
    ----------
    meshcat, path
        Meshcat to draw in, and the path of the drawing.
    X_WS
        Pose of the panel's centre: X to the right, Y down, Z away from the viewer.
    width, height
        Size of the panel, in m.
    frames, period
        Parameters of the film; see `Film`.
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        path: str,
        X_WS: RigidTransform,
        width: float,
        height: float,
        frames: int,
        period: float,
    ) -> None:
        self._X_WS, self._size = X_WS, (width, height)
        panel = Box(width, height, _THICKNESS)
        meshcat.SetObject(f"{path}/panel", panel, rgba(PANEL))
        meshcat.SetTransform(f"{path}/panel", X_WS)
        self._film = Film(meshcat=meshcat, path=f"{path}/pictures", frames=frames, period=period)

    def show(
        self, volume: Volume, slices: Sequence[Plane], pictures: Sequence[bytes], time: float
    ) -> None:
        """Show the pictures of at most two slices of a volume."""
        places = screen_planes(slices, volume.upper - volume.origin, *self._size)
        planes = [place.transformed(self._X_WS) for place in places]
        self._film.show(gltf_textured_quads(planes, pictures), time)


def screen_planes(
    slices: Sequence[Plane], extent: ArrayLike, width: float, height: float
) -> list[Plane]:
    """Return the planes on a screen in which the pictures of slices lie, in its frame.

    Parameters
    ----------
    slices
        At most two planes in P. In the first one the beam's axis is upright.
    extent
        (3,) extents of the volume along X, Y and Z of P, in m. The pictures of a sector fit at
        every turn of the slices about the beam. For a given screen, their scale depends only on
        these extents.
    width, height
        Size of the screen, in m.
    """
    x, depth, z = np.asarray(extent, dtype=float)
    across, below = np.hypot(x, z), 0.8 * max(x, z)
    scale = min((width - 2 * _MARGIN) / across, (height - 3 * _MARGIN) / (depth + below))
    face = -0.5 * height + _MARGIN
    middle = face + scale * (depth + 0.5 * below) + _MARGIN
    planes = []
    for number, plane in enumerate(slices):
        right, down, _ = plane.X_PS.rotation().inverse() @ plane.X_PS.translation()
        y = middle if number else face + scale * down
        place = RigidTransform([scale * right, y, _IN_FRONT])
        planes.append(Plane(place, scale * plane.width, scale * plane.height))
    return planes


def facing(camera: Sequence[float], target: Sequence[float]) -> RotationMatrix:
    """Return the rotation of a panel that faces a camera: X right, Y down, Z away from it."""
    away = np.subtract(target, camera)
    right = np.cross(away, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(away):  # it looks straight down or up
        right = np.array([1.0, 0.0, 0.0])
    axes: list[Any] = [each / np.linalg.norm(each) for each in (right, away)]
    return RotationMatrix(np.stack([axes[0], np.cross(axes[1], axes[0]), axes[1]], axis=1))
