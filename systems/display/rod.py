"""A rod of rigid pieces in Meshcat."""

from itertools import pairwise

from numpy.typing import ArrayLike
from pydrake.geometry import Cylinder, Meshcat, Rgba

from sonoservo.systems.display.shapes import resample, segment_pose


def set_visible(meshcat: Meshcat, path: str, visible: bool, time: float) -> None:
    """Show or hide what was hidden at first, live and in the recording."""
    recording = meshcat.get_mutable_recording()
    # A track holds its first value even before its first key: say that it began hidden.
    recording.SetProperty(0, path, "visible", False)
    meshcat.SetProperty(path, "visible", visible, time)


class Rod:
    """A polyline drawn as a fixed number of cylinders that are posed and stretched.

    Meshcat's recordings keep transforms and properties but no new shapes, so nothing else may
    change once the rod is made. A new rod is hidden.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    radius
        In m.
    colour
        Of the cylinders.
    segments
        Number of cylinders.
    """

    def __init__(
        self, *, meshcat: Meshcat, path: str, radius: float, colour: Rgba, segments: int = 1
    ) -> None:
        self._meshcat, self._path, self._segments = meshcat, path, segments
        for number in range(segments):
            meshcat.SetObject(f"{path}/{number}/unit", Cylinder(radius, 1.0), colour)
        meshcat.SetProperty(path, "visible", False)
        self._visible = False

    def show(self, polyline: ArrayLike, time: float) -> None:
        """Draw the rod along an (m, 3) polyline."""
        for number, ends in enumerate(pairwise(resample(polyline, self._segments + 1))):
            X, length = segment_pose(*ends)
            path = f"{self._path}/{number}"
            self._meshcat.SetTransform(path, X, time)
            self._meshcat.SetProperty(f"{path}/unit", "scale", [1, 1, max(length, 1e-6)], time)
        self._set_visible(True, time)

    def hide(self, time: float) -> None:
        """Do not draw it."""
        self._set_visible(False, time)

    def _set_visible(self, visible: bool, time: float) -> None:
        if visible != self._visible:
            set_visible(self._meshcat, self._path, visible, time)
            self._visible = visible
