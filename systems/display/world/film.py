"""Changing pictures that Meshcat's recording keeps."""

import numpy as np
from pydrake.geometry import Meshcat

from sonoservo.systems.display.textured_quads import gltf_mesh

# Number of pictures held, besides those of a replay, for pages that have yet to fetch them.
_RECENT = 16


class Film:
    """A changing picture, shown live and in the recording.

    Recordings cannot add shapes, so each kept picture is a hidden shape of its own, which the
    recording shows from its time to the next one's. At most `frames` are kept, `period` s apart.
    """

    def __init__(self, *, meshcat: Meshcat, path: str, frames: int, period: float) -> None:
        self._meshcat, self._path = meshcat, path
        self._frames, self._period = frames, period
        self._kept = self._shown = 0
        self._newest = -np.inf

    def show(self, gltf: str, time: float) -> None:
        """Draw a glTF document, which contains its own pose.

        A transform in Meshcat would also move the previous picture on a slow page.
        """
        live = f"{self._path}/live"
        mesh = gltf_mesh(gltf)
        self._meshcat.SetObject(live, mesh)
        if self._kept == self._frames or time < self._newest + self._period:
            # Meshcat drops the textures of a replaced object, but a slow page may still ask for
            # them.
            recent = f"{self._path}/recent/{self._shown % _RECENT}"
            self._meshcat.SetObject(recent, mesh)
            self._meshcat.SetProperty(recent, "visible", False)
            self._shown += 1
            return
        path = f"{self._path}/{self._kept}"
        self._meshcat.SetObject(path, mesh)
        self._meshcat.SetProperty(path, "visible", False)
        recording = self._meshcat.get_mutable_recording()
        frame = recording.frame(time)
        # A track holds its first value before its first key, so each shape starts hidden.
        recording.SetProperty(0, live, "visible", False)
        recording.SetProperty(0, path, "visible", False)
        recording.SetProperty(frame, path, "visible", True)
        if self._kept:
            recording.SetProperty(frame, f"{self._path}/{self._kept - 1}", "visible", False)
        self._kept, self._newest = self._kept + 1, time
