"""Recorded volumes from this program or from others."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import SCALE, VolumeFile, check_grid
from sonoservo.systems.recording.file_grid import FileGrid, make_file_grid
from sonoservo.systems.recording.file_items import FileItems
from sonoservo.systems.recording.grey_levels import GreyWindow, void_flags
from sonoservo.systems.recording.side_files import (
    ACQUISITION,
    Acquisition,
    read_acquisition,
    side_path,
)
from sonoservo.systems.sampling.seen_hull import seen_hull
from sonoservo.systems.signals.immutable import seal
from sonoservo.systems.signals.requirements import require_within
from sonoservo.systems.signals.sweep import DECIBELS_PER_LEVEL, DYNAMIC_RANGE_DB
from sonoservo.systems.signals.volume import Volume

_ASKEW = 0.1  # Largest deviation of R^T R from the identity; 0.1 is a right angle that is 6 deg off


class Recording(FileItems):
    """Volumes in a file, read on demand, one at a time.

    Without poses of the probe, the world frame W is the file's own frame L: LPS, in m.

    Parameters
    ----------
    path
        Path of a file of one of the `FORMATS`, with one volume or a sequence.
    depth
        Direction of the sound in the file's space, as an anatomical letter (`make_file_grid`).
    window
        Numbers that become the grey levels 0 and 255. By default, a recording of this program has
        the window 0 to 255, and other files the `choose_window` of their first volumes that show
        something.
    dynamic_range_db
        Range of echo amplitudes that the grey levels 0 to 255 show, in dB; by default the value in
        the file, or else 60.
    volume_rate
        Volumes per second, in Hz, for a sequence without times.
    timed
        Whether times matter; if not, those of the volumes are their numbers.
    poses
        Transforms that give the pose, or ends of their chain (`find_chain`); "none" ignores poses.
    transforms
        Transforms that all volumes share, by name, in mm. They count before the file's own.
    orientation
        Orientation of the images, if the file does not state it (`as_plus_means`).
    void
        Number that stands for what was not seen, besides those that `void_flags` knows.
    luminance
        Whether to take the luminance of colours.

    Attributes
    ----------
    posed
        Whether the file contains the probe's poses.
    settings
        Settings stored by this program's recorder; empty for files of other programs.

    Raises
    ------
    ConfigurationError
        If the file is not valid; the message names the file and the fault.
    """

    frame = "LPS"
    """Name of L."""

    def __init__(
        self,
        path: str | Path,
        *,
        depth: str = "P",
        window: tuple[float, float] | None = None,
        dynamic_range_db: float | None = None,
        volume_rate: float | None = None,
        timed: bool = True,
        poses: str | None = None,
        transforms: Mapping[str, NDArray[np.float64]] | None = None,
        orientation: str = "",
        void: float | None = None,
        luminance: bool = False,
    ) -> None:
        with refusing_failures(path):
            super().__init__(path, orientation, void, luminance)
            file = self.file
            self._acquisition = self._read_acquisition(depth)
            chain = None
            if self._acquisition is None:
                chain = self._find_chain(poses, transforms)
                times = self._stated_times(volume_rate, timed)
            else:
                times = np.array(self._acquisition.times[: file.count])
            self.posed = bool(self._acquisition) or chain is not None
            self.settings: dict[str, Any] = self._acquisition.settings if self._acquisition else {}
            self._decibels_per_level = self._scale(dynamic_range_db)
            matrices = self._choose(chain, times)
            directions, origin = _spacing_of_volumes(self.path, self._fields, file)
            if chain is not None and chain.start.startswith("Image"):
                directions, origin = _pixel_grid(directions, origin, matrices[0])
            check_grid(self.path, file.shape, directions, origin)
            self._grid: FileGrid = make_file_grid(directions, origin, file.shape, depth)
            self._poses = {}
            if chain is not None:
                pixels = np.eye(4)
                if chain.start.startswith("Image"):  # its coordinates are voxels, not mm
                    pixels[:3, :3], pixels[:3, 3] = directions, origin
                self._poses = {
                    k: _rigid(self.path, f"volume {k}: {chain}", matrix @ np.linalg.inv(pixels))
                    for k, matrix in zip(self.numbers, matrices, strict=True)
                }
            if window is not None:
                self._window = GreyWindow(*window)
            elif self._acquisition is not None:
                self._window = GreyWindow(0, 255)  # this program's recorder writes grey levels
            else:
                self._window = self._choose_window()

    def __iter__(self) -> Iterator[Volume]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, number: int) -> Volume:
        """Read a volume."""
        with refusing_failures(self.path, f"volume {number}"):
            return self._read(number)

    def _read(self, number: int) -> Volume:
        k = self.numbers[number]
        voxels = self._pixels(k)
        void = void_flags(voxels, self._void)
        grey = seal(self._window.grey(voxels, void))
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
            mask=None if void is None else seen_hull(grey) & ~void,
        ).without_cut()

    def X_WL(self, number: int) -> RigidTransform:
        """Return the pose in W of the file's frame L (LPS, in m) when a volume was acquired."""
        k = self.numbers[number]
        if self._acquisition is not None:
            return self._acquisition.poses[k] @ self._grid.X_LP.inverse()
        return self._poses.get(k, RigidTransform())

    def _pixels(self, number: int) -> NDArray[Any]:
        """Return the file's numbers of a volume with the index [x, y, z] in P."""
        return self._grid.arrange(super()._pixels(number))

    @property
    def states_range(self) -> bool:
        """Whether the file states the dB from black to white."""
        exact = self._acquisition
        return SCALE in self.file.fields or bool(exact and exact.decibels_per_level)

    def _read_acquisition(self, depth: str) -> Acquisition | None:
        path = side_path(self.path, ACQUISITION)
        if not path.is_file():
            return None
        file = self.file
        check_grid(self.path, file.shape, file.directions, file.origin)
        grid = make_file_grid(file.directions, file.origin, file.shape, depth)
        exact = read_acquisition(path)
        times = np.array(exact.times[: file.count])
        if len(times) < file.count or (
            file.times is not None and not np.allclose(times, file.times, rtol=0, atol=1e-6)
        ):
            fault = "its volumes are others than those"
        elif not np.allclose([exact.origin, exact.spacing], [grid.origin, grid.spacing], atol=1e-9):
            fault = "its grid is not that" + f" with --depth {depth}" * (depth != "P")
        else:
            return exact
        raise ConfigurationError(
            f"{path}: it does not belong to the recording {self.path}: {fault}; without it, the "
            "recording is read by its header"
        )

    def _scale(self, dynamic_range_db: float | None) -> float:
        """Return dB per grey level: from the argument, from the file, or else 60 dB / 255."""
        if dynamic_range_db is not None:
            require_within("dynamic_range_db", dynamic_range_db, *DYNAMIC_RANGE_DB)
            return dynamic_range_db / 255
        noted = self._acquisition.decibels_per_level if self._acquisition else None
        if noted is None:
            noted = float(self.file.fields.get(SCALE, DECIBELS_PER_LEVEL))
        require_within(SCALE, noted, *(limit / 255 for limit in DYNAMIC_RANGE_DB))
        return noted


def _spacing_of_volumes(
    path: Path, frames: Mapping[str, Mapping[int, str]], file: VolumeFile
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return steps and origin of the header, or with the one spacing that its volumes state."""
    stated = set(frames.get("ElementSpacing", {}).values())
    if not stated:
        return file.directions, file.origin
    spacing = np.array(stated.pop().split(), float) if len(stated) == 1 else np.zeros(0)
    if spacing.shape != (3,) or not (spacing > 0).all():
        raise ConfigurationError(
            f"{path}: ElementSpacing: its volumes differ in it, or it is not three lengths in mm"
        )
    unit = file.directions / np.linalg.norm(file.directions, axis=0)
    return unit * spacing, file.origin


def _pixel_grid(
    directions: NDArray[np.float64], origin: NDArray[np.float64], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return steps and origin in mm with the size of voxels that a transform from voxels states."""
    stated, said = (np.linalg.norm(each[:3, :3], axis=0) for each in (directions, matrix))
    if np.allclose(stated, said, rtol=1e-3):
        return directions, origin
    unit = directions / stated
    return unit * said, unit @ (unit.T @ origin / stated * said)


def _rigid(path: Path, name: str, matrix: NDArray[np.float64]) -> RigidTransform:
    """Return the pose of L in W, in m, nearest to a transform in mm, perhaps askew."""
    R = matrix[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > _ASKEW or np.linalg.det(R) < 0:
        lengths = np.linalg.norm(R, axis=0)
        unit = R / np.where(lengths > 0, lengths, 1)
        square = np.abs(unit.T @ unit - np.eye(3)).max() < _ASKEW
        causes = []
        if square and np.abs(lengths - 1).max() > 1e-2:
            same = np.ptp(lengths) < 1e-3 * lengths.max()
            shown = lengths[:1] if same else lengths
            causes.append(f"its axes are scaled by {' x '.join(f'{each:.4g}' for each in shown)}")
        if np.linalg.det(R) < 0:
            causes.append("it is mirrored")
        said = ", and ".join(causes) or "its axes are not at right angles"
        raise ConfigurationError(f"{path}: {name}: {R.round(4).tolist()} is not a rotation: {said}")
    U, _, V = np.linalg.svd(R)
    return RigidTransform(RotationMatrix(U @ V), 1e-3 * matrix[:3, 3])
