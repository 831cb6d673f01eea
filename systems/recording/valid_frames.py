"""Choice of the valid volumes or frames of a file, with their poses and times."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.files.volume_file import MAX_POSITION, VolumeFile

MAX_TIME = 1e11
"""Largest time in s; the seconds since 1970 are a hundredth of it."""

_MIN_STEP = 1e-6
"""Smallest time between two volumes or frames, in s."""


def choose_transform(
    path: Path, frames: Mapping[str, Mapping[int, str]], poses: str | None
) -> str | None:
    """Return the name of the transform that is the probe's pose; None if there is none.

    Parameters
    ----------
    path
        Path of the file, for errors.
    frames
        Fields of single volumes (`VolumeFile.frame_fields`).
    poses
        Name of the transform; "none" for no poses, None for the only one in the file.

    Raises
    ------
    ConfigurationError
        If there is no such transform, or a choice among several is missing.
    """
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


def valid_frames(
    file: VolumeFile, frames: Mapping[str, Mapping[int, str]], transform: str | None
) -> NDArray[np.int64]:
    """Return the numbers of the volumes or frames that have a pose and are not marked as invalid.

    Parameters
    ----------
    file
        File with the volumes or frames.
    frames
        Their fields (`VolumeFile.frame_fields`).
    transform
        Name of the transform that is their pose; None if poses do not matter.
    """
    valid = np.ones(file.count, bool)
    if transform is not None:
        valid[:] = False
        valid[[k for k in frames[transform] if k < file.count]] = True
    for name in ("ImageStatus", f"{transform}Status"):
        marks = frames.get(name, {}).items()
        valid[[k for k, mark in marks if k < file.count and mark.upper() != "OK"]] = False
    return np.flatnonzero(valid)


def frame_times(path: Path, count: int, stamps: Mapping[int, str]) -> NDArray[np.float64]:
    """Return the (count,) times in s from the fields ``Timestamp``; NaN where there is none."""
    times = np.full(count, np.nan)
    for k, stamp in stamps.items():
        if k < count:
            try:
                times[k] = float(stamp)
            except ValueError as error:
                raise ConfigurationError(f"{path}: Timestamp: {error}") from error
    return times


def check_times(
    path: Path, times: NDArray[np.float64], numbers: Iterable[int], what: str = "volume"
) -> None:
    """Check that the times of volumes or frames are plausible, and rise.

    Parameters
    ----------
    path
        Path of the file, for errors.
    times
        (n,) times in s.
    numbers
        Numbers of the volumes or frames in the file, for errors.
    what
        Word for one of them, for errors.

    Raises
    ------
    ConfigurationError
        If they are not; the message names the first volume whose time is wrong.
    """
    plausible = np.abs(times) <= MAX_TIME
    rising = np.concatenate([[True], np.diff(times) >= _MIN_STEP])
    wrong = np.flatnonzero(~(plausible & rising))
    if len(wrong):
        number, time = list(numbers)[wrong[0]], times[wrong[0]]
        if np.isfinite(time) and not plausible[wrong[0]]:
            raise ConfigurationError(
                f"{path}: the time of {what} {number}, {time:g} s, is out of range "
                f"(+-{MAX_TIME:g} s)"
            )
        raise ConfigurationError(
            f"{path}: the time of {what} {number} is missing, or not later than the one before"
        )


def read_matrix(path: Path, name: str, text: str) -> NDArray[np.float64]:
    """Return the (4, 4) matrix of a transform as PLUS writes it: row by row, in mm.

    Raises
    ------
    ConfigurationError
        If it is none; the message names the file and the transform.
    """
    try:
        matrix = np.array(text.split(), float).reshape(4, 4)
        require_homogeneous(matrix, MAX_POSITION)
    except ValueError as error:
        raise ConfigurationError(
            f"{path}: {name}: {text[:100]!r} is not a 4 x 4 matrix whose last row is 0 0 0 1, "
            f"with positions within +-{MAX_POSITION:g} mm"
        ) from error
    return matrix


def require_homogeneous(matrix: ArrayLike, max_position: float) -> None:
    """Raise ValueError unless (..., 4, 4) matrices are finite and have the last row 0 0 0 1.

    Parameters
    ----------
    matrix
        Matrices to check.
    max_position
        Largest coordinate of their positions, in the same unit.
    """
    matrices = np.asarray(matrix, float)
    right = (
        matrices.shape[-2:] == (4, 4)
        and np.isfinite(matrices).all()
        and (matrices[..., 3, :] == [0, 0, 0, 1]).all()
        and (np.abs(matrices[..., :3, 3]) <= max_position).all()
    )
    if not right:
        raise ValueError(
            f"a pose is not a finite 4 x 4 matrix whose last row is 0 0 0 1, with positions within "
            f"+-{max_position:g}"
        )
