"""Recorded volumes from this program or from others."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.files.typed_yaml import ConfigurationError, suggest
from sonoservo.systems.recording.file_grid import FileGrid, make_file_grid
from sonoservo.systems.recording.grey_levels import GreyWindow, choose_window
from sonoservo.systems.recording.meta_image import open_meta_image
from sonoservo.systems.recording.nrrd import open_nrrd
from sonoservo.systems.recording.side_files import (
    ACQUISITION,
    Acquisition,
    read_acquisition,
    side_path,
)
from sonoservo.systems.recording.volume_file import SCALE, VolumeFile
from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL
from sonoservo.systems.signals.volume import Volume

_FORMATS = {
    ".nrrd": open_nrrd,
    ".nhdr": open_nrrd,
    ".mha": open_meta_image,
    ".mhd": open_meta_image,
}


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
        self._file = _open(self.path)
        file = self._file
        try:
            self._grid: FileGrid = make_file_grid(file.directions, file.origin, file.shape, depth)
            self._window = GreyWindow(*window) if window else None
        except ValueError as error:
            raise ConfigurationError(f"{self.path}: {error}") from error
        self._acquisition = self._read_acquisition()
        if self._acquisition is not None and window is None:
            self._window = GreyWindow(0, 255)  # this program's recorder writes grey levels
        frames = file.frame_fields()
        transform = None if self._acquisition else choose_transform(self.path, frames, poses)
        self.posed = bool(self._acquisition) or transform is not None
        self.settings: dict[str, Any] = self._acquisition.settings if self._acquisition else {}
        self._decibels_per_level = self._scale(dynamic_range_db)
        statuses = [frames.get("ImageStatus", {})]
        if transform is not None:
            statuses.append(frames.get(f"{transform}Status", {}))
            missing = {k: "MISSING" for k in range(file.count) if k not in frames[transform]}
            statuses.append(missing)
        self._numbers = [
            k
            for k in range(file.count)
            if all(status.get(k, "OK").upper() == "OK" for status in statuses)
        ]
        self.skipped = file.count - len(self._numbers)
        if not self._numbers:
            raise ConfigurationError(f"{self.path}: all of its {file.count} volumes are invalid")
        times = self._file_times(frames.get("Timestamp", {}), volume_rate)
        self.times = times[self._numbers]
        self._X_WL = {
            k: self._pose(transform, frames[transform][k]) if transform else RigidTransform()
            for k in self._numbers
        }
        self._check_times()

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
        k = self._numbers[number]
        voxels = self._file.read(k)
        if voxels.dtype.kind == "f" and not np.isfinite(voxels).all():
            raise ConfigurationError(f"{self.path}: volume {k} holds values that are not finite")
        voxels = self._grid.arrange(voxels)
        if self._window is None:
            first = voxels if number == 0 else self._grid.arrange(self._file.read(self._numbers[0]))
            self._window = choose_window(first)
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
            self._X_WL[k] @ self._grid.X_LP,
            float(self.times[number]),
            decibels_per_level=self._decibels_per_level,
        )

    def X_WL(self, number: int) -> RigidTransform:
        """Return the pose in W of the file's frame L (LPS, in m) when a volume was acquired."""
        k = self._numbers[number]
        if self._acquisition is not None:
            return self._acquisition.poses[k] @ self._grid.X_LP.inverse()
        return self._X_WL[k]

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
        noted = self._acquisition.decibels_per_level if self._acquisition else None
        try:
            if dynamic_range_db is not None:
                require_positive(dynamic_range_db=dynamic_range_db)
                return dynamic_range_db / 255
            if noted is None:
                noted = float(self._file.fields.get(SCALE, DECIBELS_PER_LEVEL))
            require_positive(**{SCALE: noted})
        except ValueError as error:
            raise ConfigurationError(f"{self.path}: {error}") from error
        return noted

    def _file_times(
        self, timestamps: dict[int, str], volume_rate: float | None
    ) -> NDArray[np.float64]:
        count = self._file.count
        if self._acquisition is not None:
            return np.array(self._acquisition.times[:count])
        if volume_rate is not None:
            if not volume_rate > 0:
                raise ConfigurationError(f"volume rate: {volume_rate!r} must be above 0")
            return np.arange(count) / volume_rate
        if self._file.times is not None:
            return self._file.times
        if timestamps:
            try:
                return np.array([float(timestamps.get(k, "nan")) for k in range(count)])
            except ValueError as error:
                raise ConfigurationError(f"{self.path}: Timestamp: {error}") from error
        if count > 1:
            raise ConfigurationError(
                f"{self.path}: the times of its volumes are missing; give their rate "
                "(--volume-rate)"
            )
        return np.zeros(1)

    def _check_times(self) -> None:
        steps = np.diff(self.times)
        if not np.isfinite(self.times).all() or (steps <= 0).any():
            late = int(np.argmin(np.concatenate([[1.0], steps]) > 0))
            raise ConfigurationError(
                f"{self.path}: the time of volume {self._numbers[late]} is missing, or not later "
                "than the one before"
            )

    def _pose(self, name: str, text: str) -> RigidTransform:
        """Return the pose of L in W from a transform as PLUS writes it."""
        matrix = read_matrix(self.path, name, text)
        if name.startswith("Image"):  # its coordinates are voxels, not mm
            header = np.eye(4)
            header[:3, :3], header[:3, 3] = self._file.directions, self._file.origin
            matrix = matrix @ np.linalg.inv(header)
        R = matrix[:3, :3]
        rigid = np.isfinite(matrix).all() and np.abs(R.T @ R - np.eye(3)).max() < 1e-3
        if not rigid or np.linalg.det(R) < 0:
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


def read_matrix(path: Path, name: str, text: str) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of a transform as PLUS writes it: row by row, in mm."""
    try:
        return np.array(text.split(), float).reshape(4, 4)
    except ValueError as error:
        raise ConfigurationError(f"{path}: {name}: {text!r} is not a 4 x 4 matrix") from error


def choose_transform(
    path: Path, frames: dict[str, dict[int, str]], poses: str | None
) -> str | None:
    """Return the name of the transform that is the probe's pose; None if there is none."""
    names = sorted(name for name in frames if name.endswith("Transform"))
    if poses == "none" or (poses is None and not names):
        return None
    if poses is not None:
        wanted = poses if poses.endswith("Transform") else f"{poses}Transform"
        if wanted not in names:
            raise ConfigurationError(
                f"{path}: it has no transform {poses!r}; {suggest(wanted, names)}"
            )
        return wanted
    if len(names) > 1:
        raise ConfigurationError(
            f"{path}: it has several transforms. Choose one with --poses: "
            f"{', '.join(name.removesuffix('Transform') for name in names)}, or none"
        )
    return names[0]
