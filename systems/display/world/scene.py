"""Where a view begins: camera and background."""

from collections.abc import Sequence
from typing import Any

from pydrake.geometry import Meshcat


def set_scene(
    meshcat: Meshcat, camera: Sequence[float], target: Sequence[float], field_of_view_deg: float
) -> None:
    """Take Meshcat's axes and grid away, make the background light, and place the camera.

    Parameters
    ----------
    meshcat
        Whose page it is.
    camera, target
        Where the camera is, and what is in the middle of the view, in W, in m.
    field_of_view_deg
        From the lower edge of the view to the upper one.
    """
    for each in ("/Axes", "/Grid"):
        meshcat.SetProperty(each, "visible", False)
    meshcat.SetProperty("/Background/<object>", "top_color", [0.96, 0.97, 0.98])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.72, 0.74, 0.77])
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=field_of_view_deg, aspect=1.5))
    place: Any = (camera, target)  # Drake's stubs want arrays
    meshcat.SetCameraPose(*place)
