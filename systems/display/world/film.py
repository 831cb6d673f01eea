"""Slices that stay in Meshcat's recording."""

import numpy as np
from pydrake.geometry import Meshcat

from sonoservo.systems.display.textured_quads import gltf_mesh

_RECENT = 16
"""Pictures held for pages that have not fetched them yet, where none is kept for a replay."""


class Film:
    """A picture that changes, live and in a recording.

    Meshcat's recordings keep no new shapes. So each picture is kept as a shape of its own, hidden
    from the live page, and the recording shows it from its time on until the next one's.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    frames
        Most pictures kept; the last one then stays to the recording's end. None is kept at 0.
    period
        Least time between pictures kept, in s.
    """

    def __init__(self, *, meshcat: Meshcat, path: str, frames: int, period: float) -> None:
        self._meshcat, self._path = meshcat, path
        self._frames, self._period = frames, period
        self._kept = self._shown = 0
        self._newest = -np.inf

    def show(self, gltf: str, time: float) -> None:
        """Draw a glTF document.

        It has its place in itself: a transform would move what a slow page still shows.
        """
        live = f"{self._path}/live"
        mesh = gltf_mesh(gltf)
        self._meshcat.SetObject(live, mesh)
        if not self._frames:
            # Meshcat forgets the textures of what has been replaced, and a slow page asks later.
            recent = f"{self._path}/recent/{self._shown % _RECENT}"
            self._meshcat.SetObject(recent, mesh)
            self._meshcat.SetProperty(recent, "visible", False)
            self._shown += 1
        if self._kept == self._frames or time < self._newest + self._period:
            return
        path = f"{self._path}/{self._kept}"
        self._meshcat.SetObject(path, mesh)
        self._meshcat.SetProperty(path, "visible", False)
        recording = self._meshcat.get_mutable_recording()
        frame = recording.frame(time)
        # A track holds its first value before its first key, so each one starts out hidden.
        recording.SetProperty(0, live, "visible", False)
        recording.SetProperty(0, path, "visible", False)
        recording.SetProperty(frame, path, "visible", True)
        if self._kept:
            recording.SetProperty(frame, f"{self._path}/{self._kept - 1}", "visible", False)
        self._kept, self._newest = self._kept + 1, time
