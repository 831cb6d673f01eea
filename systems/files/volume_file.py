"""Contents of a file of volumes, independent of its format."""

import math
import re
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures

MAX_HEADER = 1 << 26
"""Largest header in bytes; a sequence with poses takes some hundred bytes per volume."""

SCALE = "decibels_per_level"
"""Field of a header that holds the dB per grey level."""

MIN_SPACING, MAX_SPACING = 0.01, 20.0
"""Limits of the distance between neighbouring voxels, in mm."""

MAX_EXTENT = 1e3
"""Largest extent of a volume, in mm."""

MAX_POSITION = 1e5
"""Largest distance of a volume or a pose from the origin, in mm."""

_BYTES_PER_VOXEL = 32
"""Memory that the work on a volume takes for each voxel, in bytes."""

_BYTES_PER_VOLUME = 4000
"""Memory for the time, the pose and the fields of a volume in a sequence, in bytes."""

MAX_DEFLATED = 1032
"""Highest compression ratio of Deflate."""

_PIECE = 1 << 20
"""Number of bytes read at a time."""

_FRAME_FIELD = re.compile(r"Seq_Frame(\d{1,9})_(\w+)")


class HoldsFramesError(ConfigurationError):
    """A file was taken to hold volumes, but holds 2D frames."""


@dataclass(frozen=True, eq=False)
class VolumeFile:
    """Volumes in a file, as its header describes them.

    Parameters
    ----------
    path
        Path of the file.
    shape
        Numbers of voxels along the file's three spatial axes.
    count
        Number of volumes.
    directions
        (3, 3) array whose columns are the steps from one voxel to the next along each axis, in mm,
        in LPS.
    origin
        (3,) position of the first voxel in mm, in LPS.
    read
        Function that returns the n-th volume, of shape `shape`, in any memory order. It raises
        `ConfigurationError` if the file has less data than its header announces.
    times
        (count,) times of the volumes in s; None if the file has none.
    fields
        Fields of the header, by name.

    Raises
    ------
    ConfigurationError
        If a volume, or the number of volumes, is beyond the budget of memory.
    """

    path: Path
    shape: tuple[int, int, int]
    count: int
    directions: NDArray[np.float64]
    origin: NDArray[np.float64]
    read: Callable[[int], NDArray[Any]]
    times: NDArray[np.float64] | None = None
    fields: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_voxels(self.path, self.shape)
        require_memory(_BYTES_PER_VOLUME * self.count, str(self.path), f"{self.count} volumes")

    def frame_fields(self) -> dict[str, dict[int, str]]:
        """Return the fields of single volumes (``Seq_Frame0012_Name``, as in PLUS files).

        The result is indexed by the field's name, then by the volume's number.
        """
        found: dict[str, dict[int, str]] = {}
        for key, value in self.fields.items():
            if match := _FRAME_FIELD.fullmatch(key):
                found.setdefault(match[2], {})[int(match[1])] = str(value)
        return found


def require_voxels(path: Path, shape: Sequence[int]) -> None:
    """Refuse a volume on which the work would take more memory than the budget.

    Raises
    ------
    ConfigurationError
        If it would; the message names the file and the number of voxels.
    """
    require_memory(_BYTES_PER_VOXEL * math.prod(shape), str(path), f"{_times(shape)} voxels")


def check_layout(
    path: Path,
    shape: tuple[int, ...],
    count: int,
    directions: NDArray[np.float64],
    *,
    frames: bool = False,
) -> None:
    """Check that a layout is a grid of volumes or, with ``frames``, a sequence of 2D frames.

    Raises
    ------
    ConfigurationError
        If it is neither; the message names the file and the fault.
    """
    if count < 1 or min(shape) < 1:
        raise ConfigurationError(f"{path}: {count} volumes of {_times(shape)} voxels: it is empty")
    if frames and (shape[2] != 1 or min(shape[:2]) < 2):
        raise ConfigurationError(f"{path}: {_times(shape)} voxels are not 2D frames")
    if not frames and min(shape) < 2:
        raise HoldsFramesError(
            f"{path}: {_times(shape)} voxels are 2D frames; make volumes of them with --reconstruct"
        )
    steps = np.linalg.norm(directions, axis=0)
    if not (np.isfinite(steps) & (steps > 0)).all():
        raise ConfigurationError(f"{path}: voxel spacing {steps.tolist()} mm; it must be above 0")


def check_grid(
    path: Path,
    shape: Sequence[int],
    directions: NDArray[np.float64],
    origin: NDArray[np.float64],
) -> None:
    """Check that voxels or pixels have a plausible size, extent and position, and right angles.

    Parameters
    ----------
    path
        Path of the file, for errors.
    shape
        Numbers of voxels along n axes.
    directions
        (3, n) array whose columns are the steps along the axes, in mm.
    origin
        (3,) position of the first voxel in mm.

    Raises
    ------
    ConfigurationError
        If they have not; the message names the file and the value.
    """
    steps = np.linalg.norm(directions, axis=0)
    if not ((steps >= MIN_SPACING) & (steps <= MAX_SPACING)).all():
        raise ConfigurationError(
            f"{path}: a spacing of {_times(steps)} mm is out of range ({MIN_SPACING:g} to "
            f"{MAX_SPACING:g} mm); is the spacing in mm?"
        )
    extent = float((steps * shape).max())
    if extent > MAX_EXTENT:
        raise ConfigurationError(
            f"{path}: it is {1e-3 * extent:.3g} m wide, with a spacing of {_times(steps)} mm; at "
            f"most {1e-3 * MAX_EXTENT:g} m is allowed; is the spacing in mm?"
        )
    if not np.abs(origin).max() <= MAX_POSITION:
        raise ConfigurationError(
            f"{path}: the origin {origin.tolist()} mm is out of range (+-{MAX_POSITION:g} mm)"
        )
    unit = directions / steps
    if np.abs(unit.T @ unit - np.eye(len(steps))).max() > 1e-3:
        raise ConfigurationError(f"{path}: the directions of its axes are not at right angles")


def _times(numbers: Iterable[float]) -> str:
    return " x ".join(f"{n:g}" if isinstance(n, float) else str(n) for n in numbers)


class DataSection:
    """Raw or compressed data of a file, read piece by piece.

    Parameters
    ----------
    path
        Path of the file.
    offset
        Offset of the data in the file, in bytes.
    size
        Number of uncompressed bytes that the header announces.
    compression
        Compression of the data: "gzip", "zlib" or "" for none.

    Raises
    ------
    ConfigurationError
        If the file is too small for that many bytes.
    """

    def __init__(self, path: Path, offset: int, size: int, *, compression: str = "") -> None:
        self._path = path
        self._offset = offset
        self._size = size
        self._compression = compression
        present = path.stat().st_size - offset
        if size > present * (MAX_DEFLATED if compression else 1):
            raise ConfigurationError(
                f"{path}: truncated, or its header is wrong: the header announces {size} bytes of "
                f"voxels, the file has {max(present, 0)}"
                + (" compressed bytes" if compression else "")
            )
        self._file = path.open("rb")
        self._rewind()

    def read(self, start: int, size: int) -> bytes:
        """Return ``size`` bytes from ``start`` on; reading forwards is fast.

        Raises
        ------
        ConfigurationError
            If the data end earlier or are damaged.
        """
        with refusing_failures(self._path, "damaged or truncated"):
            if not self._compression:
                self._file.seek(self._offset + start)
                data = self._file.read(size)
            else:
                if start < self._position:
                    self._rewind()
                while self._position < start:
                    if not self._inflate(min(start - self._position, _PIECE)):
                        break
                data = self._inflate(size)
                if self._position == self._size:
                    self._inflate(1)  # the checksum follows the last byte
        if len(data) < size:
            raise ConfigurationError(
                f"{self._path}: truncated: {size} bytes of voxels are needed, {len(data)} are left"
            )
        return data

    def _rewind(self) -> None:
        self._file.seek(self._offset)
        # 15 is the largest window; adding 32 accepts the headers of both gzip and zlib.
        self._inflater = zlib.decompressobj(15 + 32)
        self._position = 0

    def _inflate(self, size: int) -> bytes:
        """Return the next ``size`` bytes; fewer only at the end of the data."""
        pieces, missing = [], size
        while missing > 0 and not self._inflater.eof:
            packed = self._inflater.unconsumed_tail or self._file.read(_PIECE)
            piece = self._inflater.decompress(packed, missing)
            if not packed and not piece:
                break
            pieces.append(piece)
            missing -= len(piece)
        self._position += size - missing
        return b"".join(pieces)
