"""Reader of tracked 2D frames as PLUS records them: ``.mha``, ``.igs.mha``."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import VolumeFile, check_grid
from sonoservo.systems.recording.grey_levels import GreyWindow, choose_window, read_numbers
from sonoservo.systems.recording.meta_image import open_meta_image
from sonoservo.systems.recording.valid_frames import (
    check_times,
    choose_transform,
    frame_times,
    read_matrix,
    valid_frames,
)

_SUFFIXES = (".mha", ".mhd")
_PREFERRED = "ImageToReferenceTransform"


class TrackedFrames:
    """2D frames with poses and times, read on demand, one at a time.

    Parameters
    ----------
    path
        Path of the file.
    poses
        Name of the transform that is the frames' pose; by default ``ImageToReference``, or the only
        transform in the file. A transform whose name begins with ``Image`` maps pixels; others map
        mm in the frame.
    window
        Numbers that become the grey levels 0 and 255; by default `choose_window` of the first
        frame.

    Attributes
    ----------
    times
        (n,) times of the frames, in s.
    X_WI
        (n, 4, 4) transforms from pixels (i, j, 0, 1) to W, in m; W is the reference frame.
    skipped
        Number of frames skipped because the file marks them or their pose as invalid.

    Raises
    ------
    ConfigurationError
        If the file is not valid; the message names the file and the fault.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        poses: str | None = None,
        window: tuple[float, float] | None = None,
    ) -> None:
        self.path = Path(path)
        if not self.path.is_file() or self.path.suffix.lower() not in _SUFFIXES:
            raise ConfigurationError(
                f"{self.path}: not a file of 2D frames; give a file of type {', '.join(_SUFFIXES)}"
            )
        with refusing_failures(self.path):
            self._open(poses, window)

    def _open(self, poses: str | None, window: tuple[float, float] | None) -> None:
        self._file = open_meta_image(self.path, frames=True)
        fields = self._file.frame_fields()
        wanted = _PREFERRED if poses is None and _PREFERRED in fields else poses
        name = choose_transform(self.path, fields, wanted)
        if name is None:
            raise ConfigurationError(
                f"{self.path}: its frames have no poses, which reconstruction needs"
            )
        self._numbers = valid_frames(self._file, fields, name)
        self.skipped = self._file.count - len(self._numbers)
        if len(self._numbers) < 2:
            raise ConfigurationError(
                f"{self.path}: {len(self._numbers)} frames have a valid pose; at least 2 are needed"
            )
        self.X_WI = np.array([self._matrix(name, fields[name][int(k)]) for k in self._numbers])
        times = frame_times(self.path, self._file.count, fields.get("Timestamp", {}))
        self.times = times[self._numbers]
        check_times(self.path, self.times, self._numbers, "frame")
        first = read_numbers(self._file, int(self._numbers[0]))
        self._window = GreyWindow(*window) if window else choose_window(first)

    @property
    def file(self) -> VolumeFile:
        """The file as its header describes it."""
        return self._file

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, number: int) -> NDArray[np.uint8] | NDArray[np.float32]:
        """Read the (ni, nj) grey levels of a frame.

        Raises
        ------
        ConfigurationError
            If the file is damaged at that frame.
        """
        with refusing_failures(self.path, f"frame {number}"):
            pixels = read_numbers(self._file, int(self._numbers[number]))
            return self._window.grey(pixels[..., 0])

    def _matrix(self, name: str, text: str) -> NDArray[np.float64]:
        matrix = read_matrix(self.path, name, text)
        if not name.startswith("Image"):
            header = np.eye(4)
            header[:3, :3], header[:3, 3] = self._file.directions, self._file.origin
            matrix = matrix @ header
        check_grid(self.path, self._file.shape[:2], matrix[:3, :2], matrix[:3, 3])
        matrix[:3] *= 1e-3
        return matrix
