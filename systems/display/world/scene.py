"""Camera and background of a view."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RotationMatrix


def set_scene(
    meshcat: Meshcat, camera: Sequence[float], target: Sequence[float], field_of_view_deg: float
) -> None:
    """Hide Meshcat's axes and grid, lighten the background and place the camera.

    Camera and target are in W, in m; the field of view goes from the lower edge to the upper one.
    """
    for each in ("/Axes", "/Grid"):
        meshcat.SetProperty(each, "visible", False)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.96, 0.97, 0.98])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.72, 0.74, 0.77])
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=field_of_view_deg, aspect=1.5))
    place: Any = (camera, target)  # Drake's stubs want arrays
    meshcat.SetCameraPose(*place)


def facing(camera: Sequence[float], target: Sequence[float]) -> RotationMatrix:
    """Return the rotation of a panel that faces a camera: X right, Y down, Z away from it."""
    away = np.subtract(target, camera)
    right = np.cross(away, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(away):  # it looks straight down or up
        right = np.array([1.0, 0.0, 0.0])
    axes: list[Any] = [each / np.linalg.norm(each) for each in (right, away)]
    return RotationMatrix(np.stack([axes[0], np.cross(axes[1], axes[0]), axes[1]], axis=1))
