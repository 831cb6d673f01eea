"""Recorded volumes from this program or from others."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.files.nrrd_reader import open_nrrd
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import SCALE, VolumeFile, check_grid
from sonoservo.systems.recording.file_grid import FileGrid, make_file_grid
from sonoservo.systems.recording.grey_levels import GreyWindow, choose_window, read_numbers
from sonoservo.systems.recording.meta_image import open_meta_image
from sonoservo.systems.recording.side_files import (
    ACQUISITION,
    Acquisition,
    read_acquisition,
    side_path,
)
from sonoservo.systems.recording.valid_frames import (
    check_times,
    choose_transform,
    frame_times,
    read_matrix,
    valid_frames,
)
from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.requirements import require_within
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL, DYNAMIC_RANGE_DB
from sonoservo.systems.signals.volume import Volume

_FORMATS = {
    ".nrrd": open_nrrd,
    ".nhdr": open_nrrd,
    ".mha": open_meta_image,
    ".mhd": open_meta_image,
}

_VOLUME_RATES = 1e-3, 1e4
"""Limits of the rate of volumes, in Hz."""


class Recording:
    """Volumes in a file, read on demand, one at a time.

    Without poses of the probe, the world frame W is the file's own frame L: LPS, in m.

    Parameters
    ----------
    path
        Path of a ``.nrrd``, ``.nhdr``, ``.mha`` or ``.mhd`` file with one volume or a sequence.
    depth
        Direction of the sound in the file's space, as an anatomical letter (`make_file_grid`).
    window
        Numbers that become the grey levels 0 and 255. By default, a recording of this program has
        the window 0 to 255, and other files the `choose_window` of their first volume.
    dynamic_range_db
        Range of echo amplitudes that the grey levels 0 to 255 show, in dB; by default the value in
        the file, or else 60.
    volume_rate
        Volumes per second, in Hz, for a sequence without times.
    poses
        Name of the transform that is the probe's pose (``ProbeToTracker``), if the file has
        several; "none" ignores poses.

    Attributes
    ----------
    times
        (n,) times of the volumes, in s.
    skipped
        Number of volumes skipped because the file marks them or their pose as invalid.
    posed
        Whether the file contains the probe's poses.
    settings
        Settings stored by this program's recorder; empty for files of other programs.

    Raises
    ------
    ConfigurationError
        If the file is not valid; the message names the file and the fault.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        depth: str = "P",
        window: tuple[float, float] | None = None,
        dynamic_range_db: float | None = None,
        volume_rate: float | None = None,
        poses: str | None = None,
    ) -> None:
        self.path = Path(path)
        with refusing_failures(self.path):
            self._file = file = _open(self.path)
            check_grid(self.path, file.shape, file.directions, file.origin)
            self._grid: FileGrid = make_file_grid(file.directions, file.origin, file.shape, depth)
            self._window = GreyWindow(*window) if window else None
            self._acquisition = self._read_acquisition()
            if self._acquisition is not None and window is None:
                self._window = GreyWindow(0, 255)  # this program's recorder writes grey levels
            frames = file.frame_fields()
            transform = None if self._acquisition else choose_transform(self.path, frames, poses)
            self.posed = bool(self._acquisition) or transform is not None
            self.settings: dict[str, Any] = self._acquisition.settings if self._acquisition else {}
            self._decibels_per_level = self._scale(dynamic_range_db)
            self._numbers = valid_frames(file, frames, transform)
            self.skipped = file.count - len(self._numbers)
            if not len(self._numbers):
                raise ConfigurationError(
                    f"{self.path}: all of its {file.count} volumes are invalid"
                )
            self.times = self._file_times(frames, volume_rate)[self._numbers]
            check_times(self.path, self.times, self._numbers)
            self._poses = (
                {int(k): self._pose(transform, frames[transform][k]) for k in self._numbers}
                if transform
                else {}
            )

    @property
    def file(self) -> VolumeFile:
        """The file as its header describes it."""
        return self._file

    def __len__(self) -> int:
        return len(self._numbers)

    def __iter__(self) -> Iterator[Volume]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, number: int) -> Volume:
        """Read a volume.

        Raises
        ------
        ConfigurationError
            If the file is damaged at that volume.
        """
        with refusing_failures(self.path, f"volume {number}"):
            return self._read(number)

    def _read(self, number: int) -> Volume:
        k = int(self._numbers[number])
        voxels = self._voxels(k)
        if self._window is None:
            first = int(self._numbers[0])
            self._window = choose_window(voxels if k == first else self._voxels(first))
        grey = seal(self._window.grey(voxels))
        if self._acquisition is not None:
            exact = self._acquisition
            return Volume(
                grey,
                exact.origin,
                exact.spacing,
                exact.poses[k],
                exact.times[k],
                exact.motions[k],
                self._decibels_per_level,
                exact.point_spread,
            )
        return Volume(
            grey,
            self._grid.origin,
            self._grid.spacing,
            self.X_WL(number) @ self._grid.X_LP,
            float(self.times[number]),
            decibels_per_level=self._decibels_per_level,
        )

    def X_WL(self, number: int) -> RigidTransform:
        """Return the pose in W of the file's frame L (LPS, in m) when a volume was acquired."""
        k = int(self._numbers[number])
        if self._acquisition is not None:
            return self._acquisition.poses[k] @ self._grid.X_LP.inverse()
        return self._poses.get(k, RigidTransform())

    def _voxels(self, k: int) -> NDArray[Any]:
        """Return the file's numbers of a volume with the index [x, y, z] in P."""
        return self._grid.arrange(read_numbers(self._file, k))

    def _read_acquisition(self) -> Acquisition | None:
        path = side_path(self.path, ACQUISITION)
        if not path.is_file():
            return None
        exact = read_acquisition(path)
        if len(exact.times) < self._file.count or not (
            np.allclose(exact.origin, self._grid.origin, atol=1e-9)
            and np.allclose(exact.spacing, self._grid.spacing, atol=1e-9)
        ):
            raise ConfigurationError(f"{path}: it does not belong to the recording {self.path}")
        return exact

    def _scale(self, dynamic_range_db: float | None) -> float:
        """Return dB per grey level: from the argument, from the file, or else 60 dB / 255."""
        if dynamic_range_db is not None:
            require_within("dynamic_range_db", dynamic_range_db, *DYNAMIC_RANGE_DB)
            return dynamic_range_db / 255
        noted = self._acquisition.decibels_per_level if self._acquisition else None
        if noted is None:
            noted = float(self._file.fields.get(SCALE, DECIBELS_PER_LEVEL))
        require_within(SCALE, noted, *(limit / 255 for limit in DYNAMIC_RANGE_DB))
        return noted

    def _file_times(
        self, frames: Mapping[str, Mapping[int, str]], volume_rate: float | None
    ) -> NDArray[np.float64]:
        count = self._file.count
        if self._acquisition is not None:
            return np.array(self._acquisition.times[:count])
        if volume_rate is not None:
            require_within("volume rate", volume_rate, *_VOLUME_RATES)
            return np.arange(count) / volume_rate
        if self._file.times is not None:
            return self._file.times
        if "Timestamp" in frames:
            return frame_times(self.path, count, frames["Timestamp"])
        if count > 1:
            raise ConfigurationError(
                f"{self.path}: the times of its volumes are missing; give their rate "
                "(--volume-rate)"
            )
        return np.zeros(1)

    def _pose(self, name: str, text: str) -> RigidTransform:
        """Return the pose of L in W from a transform as PLUS writes it."""
        matrix = read_matrix(self.path, name, text)
        if name.startswith("Image"):  # its coordinates are voxels, not mm
            header = np.eye(4)
            header[:3, :3], header[:3, 3] = self._file.directions, self._file.origin
            matrix = matrix @ np.linalg.inv(header)
        R = matrix[:3, :3]
        if np.abs(R.T @ R - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
            raise ConfigurationError(f"{self.path}: {name}: {text!r} is not a rigid transform")
        return RigidTransform(RotationMatrix.ProjectToRotationMatrix(R), 1e-3 * matrix[:3, 3])


def _open(path: Path) -> VolumeFile:
    """Open a file according to its suffix.

    Raises
    ------
    ConfigurationError
        If the file is not valid; the message names the file and the fault.
    """
    if path.is_dir():
        raise ConfigurationError(f"{path}: it is a folder; give a file with volumes")
    if not path.is_file():
        raise ConfigurationError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise ConfigurationError(f"{path}: it is empty")
    if path.suffix.lower() not in _FORMATS:
        raise ConfigurationError(
            f"{path}: this file type is not supported; use {', '.join(_FORMATS)}"
        )
    return _FORMATS[path.suffix.lower()](path)
