"""What a file with volumes says about itself, whatever its format."""

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
"""Bytes; a header of a long sequence with poses has some hundred for each volume."""

SCALE = "decibels_per_level"
"""Field of a header that tells the dB per grey level."""

_MOST_DEFLATED = 1032
"""Deflate makes data at most so many times smaller."""

_PIECE = 1 << 20
"""Bytes that are read at a time."""

_FRAME_FIELD = re.compile(r"Seq_Frame(\d{1,9})_(\w+)")


@dataclass(frozen=True, eq=False)
class VolumeFile:
    """Volumes in a file, as its format describes them.

    Parameters
    ----------
    path
        Of the file.
    shape
        Voxels along the file's three spatial axes.
    count
        Number of volumes.
    directions
        (3, 3) array, its columns the steps from one voxel to the next along each axis, in mm, in
        LPS.
    origin
        (3,) position of the first voxel in mm, in LPS.
    read
        Gives the n-th volume, (shape) in any order of memory. It raises `ConfigurationError` if the
        file has less data than its header says.
    times
        (count,) in s; None if the file tells none.
    fields
        What else its header holds, by name.
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
        """Fields of single volumes as PLUS names them, ``Seq_Frame0012_Name``: name, number."""
        found: dict[str, dict[int, str]] = {}
        for key, value in self.fields.items():
            if match := _FRAME_FIELD.fullmatch(key):
                found.setdefault(match[2], {})[int(match[1])] = str(value)
        return found


def one_line(error: Exception) -> str:
    """Return what an error of a library says, for a person to read."""
    return " ".join(str(error).replace("\0", " ").split()) or type(error).__name__


def check_layout(path: Path, shape: tuple[int, ...], count: int, directions: Any) -> None:
    """Refuse what is no grid of volumes.

    Raises
    ------
    ConfigurationError
        Naming the file and the fault.
    """
    if count < 1 or min(shape) < 1:
        raise ConfigurationError(f"{path}: {count} volumes of {_times(shape)} voxels: it is empty")
    if min(shape) < 2:
        raise ConfigurationError(
            f"{path}: {_times(shape)} voxels are 2D frames; tracking wants volumes, so reconstruct "
            "them first (PLUS: VolumeReconstructor)"
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
    """The data of a file, raw or compressed, read piece by piece.

    Parameters
    ----------
    path
        Of the file.
    offset
        Where its data begin, in bytes.
    size
        Bytes that the header promises, uncompressed.
    compression
        "gzip", "zlib" or "".

    Raises
    ------
    ConfigurationError
        If the file cannot hold that much.
    """

    def __init__(self, path: Path, offset: int, size: int, *, compression: str = "") -> None:
        self._path = path
        self._offset = offset
        self._compression = compression
        present = path.stat().st_size - offset
        if size > present * (_MOST_DEFLATED if compression else 1):
            raise ConfigurationError(
                f"{path}: truncated, or its header is wrong: {size} bytes of voxels are announced, "
                f"{max(present, 0)} are there" + (", compressed" if compression else "")
            )
        self._file = path.open("rb")
        self._rewind()

    def read(self, start: int, size: int) -> bytes:
        """Return ``size`` bytes from ``start`` on; forwards is fast.

        Raises
        ------
        ConfigurationError
            If the data end before, or are damaged.
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
                f"{self._path}: truncated: {size} bytes of voxels are wanted, {len(data)} are left"
            )
        return data

    def _rewind(self) -> None:
        self._file.seek(self._offset)
        # 15 is the largest window; 32 more accept the headers of both gzip and zlib.
        self._inflater = zlib.decompressobj(15 + 32)
        self._position = 0

    def _inflate(self, size: int) -> bytes:
        """Return the next bytes, fewer only at the end."""
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
