"""A rod of rigid pieces in Meshcat."""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba

from sonoservo.systems.display.shapes import resample, segment_pose


class Switch:
    """Shows and hides the object at a path, live and in the recording; hidden at first."""

    def __init__(self, *, meshcat: Meshcat, path: str) -> None:
        self._meshcat, self._path = meshcat, path
        self._visible = False
        self._recorded = False
        meshcat.SetProperty(path, "visible", False)

    def set(self, visible: bool, time: float) -> None:
        """Show or hide the object from a time on, in s."""
        if visible == self._visible:
            return
        if not self._recorded:
            # A track holds its first value before its first key too, so it has to start hidden.
            self._meshcat.get_mutable_recording().SetProperty(0, self._path, "visible", False)
            self._recorded = True
        self._meshcat.SetProperty(self._path, "visible", visible, time)
        self._visible = visible


class Rod:
    """A polyline drawn as a fixed number of cylinders that are posed and stretched.

    Meshcat's recordings keep transforms and properties but add no shapes. A longer polyline is
    resampled. A new rod is hidden.
    """

    def __init__(
        self, *, meshcat: Meshcat, path: str, radius: float, colour: Rgba, segments: int = 1
    ) -> None:
        self._meshcat, self._path, self._segments = meshcat, path, segments
        self._radius, self._used = radius, segments
        for number in range(segments):
            meshcat.SetObject(f"{path}/{number}/unit", Cylinder(radius, 1.0), colour)
        self._switch = Switch(meshcat=meshcat, path=path)

    def show(
        self, polyline: ArrayLike, time: float, radii: NDArray[np.float64] | None = None
    ) -> None:
        """Draw the rod along an (m, 3) polyline in m; (segments,) radii in m replace its own."""
        points = np.asarray(polyline, dtype=float)
        if len(points) > self._segments + 1 or radii is not None:
            points = resample(points, self._segments + 1)
        wide = np.ones(self._segments) if radii is None else radii / self._radius
        used = len(points) - 1
        for number, ends in enumerate(pairwise(points)):
            X, length = segment_pose(*ends)
            self._meshcat.SetTransform(f"{self._path}/{number}", X, time)
            self._stretch(number, wide[number], max(length, 1e-6), time)
        for number in range(used, self._used):
            self._stretch(number, 1e-6, 1e-6, time)
        self._used = used
        self._switch.set(True, time)

    def hide(self, time: float) -> None:
        """Hide the rod from a time on, in s."""
        self._switch.set(False, time)

    def _stretch(self, number: int, width: float, length: float, time: float) -> None:
        scale = [width, width, length]
        self._meshcat.SetProperty(f"{self._path}/{number}/unit", "scale", scale, time)
