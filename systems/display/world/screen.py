"""A screen that stands in the world and shows the slices upright."""

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

    The pictures keep the beam's axis, and the first one the probe's face, at a fixed place: only
    what is seen moves.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    X_WS
        Pose of its centre: X to the right, Y down, Z away from who looks at it.
    width, height
        Of the panel, in m.
    frames, period
        Of the film, see `Film`.
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
        """Show slices of a volume, at most two, and their pictures."""
        places = screen_planes(slices, volume.upper - volume.origin, *self._size)
        planes = [place.transformed(self._X_WS) for place in places]
        self._film.show(gltf_textured_quads(planes, pictures), time)


def screen_planes(
    slices: Sequence[Plane], extent: ArrayLike, width: float, height: float
) -> list[Plane]:
    """Return where the pictures of slices are on a screen, in its frame.

    Parameters
    ----------
    slices
        In P; at most two. The first one has the beam's axis upright.
    extent
        (3,) of the volume along X, Y and Z of P, in m. What a sector shows in slices through it
        fits, whatever their turn about the beam; their scale depends on nothing else.
    width, height
        Of the screen, in m.
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
    """How a panel is turned that a camera sees as a rectangle: X right, Y down, Z away from it."""
    away = np.subtract(target, camera)
    right = np.cross(away, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(away):  # it looks straight down, or up
        right = np.array([1.0, 0.0, 0.0])
    axes: list[Any] = [each / np.linalg.norm(each) for each in (right, away)]
    return RotationMatrix(np.stack([axes[0], np.cross(axes[1], axes[0]), axes[1]], axis=1))
