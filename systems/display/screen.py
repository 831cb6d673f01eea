"""A screen that stands in the world and shows the slices upright."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.geometry import Box, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.display.image_planes import Plane
from sonoservo.systems.display.rod import Rod
from sonoservo.systems.display.textured_quads import gltf_mesh, gltf_textured_quads, text_image

_WIDTH, _HEIGHT, _THICKNESS = 0.19, 0.22, 0.004
_FACE, _MIDDLE = -0.105, 0.048  # of the first picture, and of the second, below the centre
_IN_FRONT = -0.5 * _THICKNESS - 0.002
_LEFT = -0.012  # of the pictures' middle from the centre
_GAUGE = (0.078, 0.09, 0.055)  # its foot, right of and below the centre, and its length per newton
_FORCE = Rgba(0.9, 0.6, 0.0)


class Screen:
    """A dark upright panel that faces the camera: one slice above the other, and a force gauge.

    The pictures keep the beam's axis, and the first one the probe's face, at a fixed place: only
    what is seen moves.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    position
        Of its centre in W, in m.
    camera
        Which it faces, in W, in m.
    scale
        Of the pictures; 1 is life-size.
    """

    def __init__(
        self,
        *,
        meshcat: Meshcat,
        path: str,
        position: Sequence[float],
        camera: Sequence[float],
        scale: float,
    ) -> None:
        self._scale = scale
        self._X_WS = facing(position, camera)
        size = Box(scale * _WIDTH, scale * _HEIGHT, _THICKNESS)
        meshcat.SetObject(f"{path}/panel", size, Rgba(0.06, 0.06, 0.07))
        meshcat.SetTransform(path, self._X_WS)
        self._force = Rod(
            meshcat=meshcat, path=f"{path}/force", radius=0.003 * scale, colour=_FORCE
        )
        x, y, newton = _GAUGE
        texts = [text_image(f"{force} N", (0.8, 0.8, 0.8), 24) for force in range(4)]
        height = 0.01 * scale
        places = [
            Plane(
                RigidTransform([scale * (x - 0.016), scale * (y - newton * force), _IN_FRONT]),
                height * text.shape[1] / text.shape[0],
                height,
            )
            for force, text in enumerate(texts)
        ]
        meshcat.SetObject(f"{path}/ticks", gltf_mesh(gltf_textured_quads(places, texts)))

    @property
    def X_WLabel(self) -> RigidTransform:
        """Pose of a label that stands on the screen."""
        above = RigidTransform([0.0, -0.5 * self._scale * _HEIGHT - 0.02, 0.0])
        return self._X_WS @ above

    def pictures(self, slices: Sequence[Plane], X_WP: RigidTransform) -> list[Plane]:
        """Return where in P the pictures of slices are that show on the screen.

        Parameters
        ----------
        slices
            In P; at most two.
        X_WP
            Pose of the probe.
        """
        X_PS = X_WP.InvertAndCompose(self._X_WS)
        planes = []
        for number, plane in enumerate(slices):
            x, y, _ = plane.X_PS.rotation().inverse() @ plane.X_PS.translation()
            below = _MIDDLE if number else _FACE + y
            centre = [self._scale * (_LEFT + x), self._scale * below, _IN_FRONT]
            planes.append(
                Plane(
                    X_PS @ RigidTransform(centre),
                    self._scale * plane.width,
                    self._scale * plane.height,
                )
            )
        return planes

    def show_force(self, force: float, time: float) -> None:
        """Show a force in N on the gauge."""
        x, y, newton = _GAUGE
        top = y - newton * min(max(force, 0.0), 3.5)
        self._force.show(self._scale * np.array([[x, y, _IN_FRONT], [x, top, _IN_FRONT]]), time)


def facing(position: Sequence[float], camera: Sequence[float]) -> RigidTransform:
    """Pose of an upright panel that faces a camera: X to the right, Y down, Z away."""
    away = np.subtract(position, camera)
    away[2] = 0.0
    length = np.linalg.norm(away)
    away = away / length if length > 0 else np.array([0.0, 1.0, 0.0])
    down = np.array([0.0, 0.0, -1.0])
    R: Any = np.stack([np.cross(down, away), down, away], axis=1)
    return RigidTransform(RotationMatrix(R), np.array(position, dtype=float))
