"""Contents of a file of volumes, independent of its format."""

import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.typed_yaml import ConfigurationError

MAX_HEADER = 1 << 26
"""Largest header in bytes; a sequence with poses takes some hundred bytes per volume."""

SCALE = "decibels_per_level"
"""Field of a header that holds the dB per grey level."""

_MOST_DEFLATED = 1032
"""Highest compression ratio of Deflate."""

_PIECE = 1 << 20
"""Number of bytes read at a time."""

_FRAME_FIELD = re.compile(r"Seq_Frame(\d{1,9})_(\w+)")


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
    """

    path: Path
    shape: tuple[int, int, int]
    count: int
    directions: NDArray[np.float64]
    origin: NDArray[np.float64]
    read: Callable[[int], NDArray[Any]]
    times: NDArray[np.float64] | None = None
    fields: Mapping[str, str] = field(default_factory=dict)

    def frame_fields(self) -> dict[str, dict[int, str]]:
        """Return the fields of single volumes (``Seq_Frame0012_Name``, as in PLUS files).

        The result is indexed by the field's name, then by the volume's number.
        """
        found: dict[str, dict[int, str]] = {}
        for key, value in self.fields.items():
            if match := _FRAME_FIELD.fullmatch(key):
                found.setdefault(match[2], {})[int(match[1])] = str(value)
        return found


def one_line(error: Exception) -> str:
    """Return the message of a library's error on one line."""
    return " ".join(str(error).replace("\0", " ").split()) or type(error).__name__


def check_layout(
    path: Path, shape: tuple[int, ...], count: int, directions: Any, *, frames: bool = False
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
        raise ConfigurationError(
            f"{path}: {_times(shape)} voxels are 2D frames; make volumes of them with --reconstruct"
        )
    steps = np.linalg.norm(directions, axis=0)
    if not np.isfinite(directions).all() or (steps <= 0).any():
        raise ConfigurationError(f"{path}: voxel spacing {steps.tolist()} mm; it must be above 0")
    unit = directions / steps
    if np.abs(unit.T @ unit - np.eye(3)).max() > 1e-3:
        raise ConfigurationError(f"{path}: the directions of its axes are not at right angles")


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(str(n) for n in shape)


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
        self._compression = compression
        present = path.stat().st_size - offset
        if size > present * (_MOST_DEFLATED if compression else 1):
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
        try:
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
        except (OSError, zlib.error) as error:
            raise ConfigurationError(
                f"{self._path}: damaged or truncated: {one_line(error)}"
            ) from error
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
