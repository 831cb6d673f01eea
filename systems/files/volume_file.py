"""Contents of a file of volumes, independent of its format."""

import math
import re
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, BinaryIO

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

_BYTES_PER_VOXEL = 32  # Memory that the work on a volume takes for each voxel, in bytes
# Memory for the time, the pose and the fields of a volume in a sequence, in bytes.
_BYTES_PER_VOLUME = 4000
MAX_DEFLATED = 1032
"""Highest compression ratio of Deflate."""

_PIECE = 1 << 20  # Number of bytes read at a time
_GZIP = b"\x1f\x8b"

MILLIMETRES = {
    **dict.fromkeys(("mm", "millimeter", "millimetre", "millimeters", "", "?", "???"), 1.0),
    **dict.fromkeys(("um", "\N{MICRO SIGN}m", "micron"), 1e-3),
    **dict.fromkeys(("m", "meter"), 1e3),
    "cm": 10.0,
}
"""Units of length in headers, in mm; without one, mm are taken."""

SECONDS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec"), 1e-3),
    **dict.fromkeys(("us", "usec"), 1e-6),
}
"""Units of time in headers, in s."""

MAX_STEP = 5.0
"""Time in s that no scanner takes for a volume or frame: what is larger is in another unit."""

MAX_FILES = 10_000
"""Largest number of data files that a header may name."""

_PATTERN = re.compile(r"[^%]*%0?\d{0,2}[di][^%]*")

_FRAME_FIELD = re.compile(r"Seq_Frame(\d{1,9})_(\w+)")


class HoldsFramesError(ConfigurationError):
    """A file was taken to hold volumes, but holds 2D frames."""


def require_frames(path: Path, frames: bool, what: str) -> None:
    """Refuse a file of 2D frames, ``what`` in words, where volumes are expected."""
    if not frames:
        raise HoldsFramesError(
            f"{path}: {what} are 2D frames; make volumes of them with --reconstruct"
        )


@dataclass(frozen=True, eq=False)
class VolumeFile:
    """Volumes in a file, as its header describes them; refused if beyond the budget of memory."""

    path: Path
    shape: tuple[int, int, int]
    count: int
    directions: NDArray[np.float64]
    """(3, 3) steps to the next voxel along each axis, as columns, in mm in LPS."""
    origin: NDArray[np.float64]
    """(3,) place of the first voxel in mm, in LPS."""
    read: Callable[[int], NDArray[Any]]
    """Function that returns the n-th volume in any memory order, colours along a last axis, or
    raises `ConfigurationError` if data are missing."""
    times: NDArray[np.float64] | None = None
    """(count,) times in s."""
    fields: Mapping[str, str] = field(default_factory=dict)
    """Fields of the header, by name."""
    notes: tuple[str, ...] = ()
    """Sentences about the file for a person."""
    channels: int = 1
    void: float | None = None
    """Number that stands for what was not seen, if one is stated."""

    def __post_init__(self) -> None:
        require_voxels(self.path, self.shape)
        require_memory(_BYTES_PER_VOLUME * self.count, str(self.path), f"{self.count} volumes")

    def frame_fields(self) -> dict[str, dict[int, str]]:
        """Return the fields of single volumes (``Seq_Frame0012_Name``) by name and number."""
        found: dict[str, dict[int, str]] = {}
        for key, value in self.fields.items():
            if match := _FRAME_FIELD.fullmatch(key):
                found.setdefault(match[2], {})[int(match[1])] = str(value)
        return found


def require_voxels(path: Path, shape: Sequence[int]) -> None:
    """Refuse a volume on which the work would take more memory than the budget."""
    require_memory(_BYTES_PER_VOXEL * math.prod(shape), str(path), f"{_times(shape)} voxels")


def check_layout(
    path: Path,
    shape: tuple[int, ...],
    count: int,
    directions: NDArray[np.float64],
    *,
    frames: bool = False,
) -> None:
    """Refuse what is no grid of volumes or, with ``frames``, no sequence of 2D frames."""
    if count < 1 or min(shape) < 1:
        raise ConfigurationError(f"{path}: {count} volumes of {_times(shape)} voxels: it is empty")
    if frames and (shape[2] != 1 or min(shape[:2]) < 2):
        raise ConfigurationError(f"{path}: {_times(shape)} voxels are not 2D frames")
    if min(shape) < 2:
        require_frames(path, frames, f"{_times(shape)} voxels")
    steps = np.linalg.norm(directions, axis=0)
    if not (np.isfinite(steps) & (steps > 0)).all():
        raise ConfigurationError(f"{path}: voxel spacing {steps.tolist()} mm; it must be above 0")


def check_grid(
    path: Path,
    shape: Sequence[int],
    directions: NDArray[np.float64],
    origin: NDArray[np.float64],
    *,
    square: bool = True,
) -> None:
    """Refuse an implausible size, extent or position in mm of voxels or pixels, or askew axes."""
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
    # A calibration of pixels may be a little askew.
    if np.abs(unit.T @ unit - np.eye(len(steps))).max() > (1e-3 if square else 0.2):
        raise ConfigurationError(f"{path}: the directions of its axes are not at right angles")


def _times(numbers: Iterable[float]) -> str:
    return " x ".join(f"{n:g}" if isinstance(n, float) else str(n) for n in numbers)


class FieldUse(StrEnum):
    """Use that the reader makes of a header's field."""

    USED = "used"
    CHECKED = "checked"
    NO_EFFECT = "without effect"


class DataSection:
    """Raw or compressed data of a file, read by pieces; sizes are those uncompressed."""

    def __init__(
        self, path: Path, offset: int, size: int, *, compressed: bool = False, skip: int = 0
    ) -> None:
        self._path = path
        self._offset = offset
        self._size = size
        self._compressed = compressed
        self._skip = skip
        present = path.stat().st_size - offset
        if size + skip > present * (MAX_DEFLATED if compressed else 1):
            raise ConfigurationError(
                f"{path}: truncated, or its header is wrong: the header announces {size} bytes of "
                f"voxels, the file has {max(present, 0)}"
                + (" compressed bytes" if compressed else "")
            )
        self.surplus = 0 if compressed else max(present - size, 0)
        self._rewind()

    def _rewind(self) -> None:
        self._next = self._offset  # in the file; the position is among the uncompressed data
        self._begin()
        self._position = 0

    def read(self, start: int, size: int) -> bytes:
        """Return ``size`` bytes from ``start`` on; reading forwards is fast."""
        first = start + self._skip
        # Opened for each read: a series may have more files than a process may hold open.
        with refusing_failures(self._path, "damaged or truncated"), self._path.open("rb") as file:
            if not self._compressed:
                file.seek(self._offset + first)
                data = file.read(size)
            else:
                if first < self._position:
                    self._rewind()
                file.seek(self._next)
                while self._position < first:
                    if not self._inflate(file, min(first - self._position, _PIECE)):
                        break
                data = self._inflate(file, size)
                if self._position == self._size + self._skip:
                    self._inflate(file, 1)  # the checksum follows the last byte
                self._next = file.tell()
        if len(data) < size:
            raise ConfigurationError(
                f"{self._path}: truncated: {size} bytes of voxels are needed, {len(data)} are left"
            )
        return data

    def _begin(self) -> None:
        # 15 is the largest window; adding 32 accepts the headers of both gzip and zlib.
        self._inflater = zlib.decompressobj(15 + 32)

    def _inflate(self, file: BinaryIO, size: int) -> bytes:
        """Return the next ``size`` bytes; fewer only at the end of the data."""
        pieces, missing, waiting = [], size, b""
        while missing > 0:
            if self._inflater.eof:  # gzip data may consist of several members
                waiting = self._inflater.unused_data or file.read(_PIECE)
                if not waiting.startswith(_GZIP):
                    break
                self._begin()
            packed = waiting or self._inflater.unconsumed_tail or file.read(_PIECE)
            waiting = b""
            piece = self._inflater.decompress(packed, missing)
            if not packed and not piece:
                break
            pieces.append(piece)
            missing -= len(piece)
        self._position += size - missing
        return b"".join(pieces)


class DataSections:
    """Data in several files, one after the other, each with the same number of bytes."""

    def __init__(self, sections: Sequence[DataSection], size: int) -> None:
        self._sections, self._size = sections, size

    def notes(self) -> tuple[str, ...]:
        """Return a sentence about bytes that no header announces."""
        surplus = sum(each.surplus for each in self._sections)
        said = f"the data hold {surplus} bytes more than the header announces; are its sizes right?"
        return (said,) if surplus else ()

    def read(self, start: int, size: int) -> bytes:
        """Return ``size`` bytes from ``start`` on; see `DataSection.read`."""
        pieces = []
        while size > 0:
            number, first = divmod(start, self._size)
            part = min(size, self._size - first)
            pieces.append(self._sections[number].read(first, part))
            start, size = start + part, size - part
        return b"".join(pieces)


def open_data(
    path: Path,
    field_name: str,
    files: Sequence[Path],
    size: int,
    first: Callable[[Path, int], int],
    *,
    compressed: bool = False,
    skip: int = 0,
) -> DataSections:
    """Open ``size`` bytes of data that files share evenly."""
    each = size // max(len(files), 1)
    if each * len(files) != size or not files:
        raise ConfigurationError(
            f"{path}: {field_name}: {len(files)} files do not share the voxels evenly"
        )
    sections = [
        DataSection(file, first(file, each), each, compressed=compressed, skip=skip)
        for file in files
    ]
    return DataSections(sections, each)


def voxel_reader(
    data: DataSections,
    dtype: "np.dtype[Any]",
    shape: tuple[int, int, int],
    channels: int = 1,
    *,
    last: bool = False,
) -> Callable[[int], NDArray[Any]]:
    """Return the reader of `VolumeFile.read`; the channels vary first in the file, or ``last``."""
    size = math.prod(shape) * channels * dtype.itemsize

    def read(number: int) -> NDArray[Any]:
        numbers = np.frombuffer(data.read(number * size, size), dtype)
        if channels == 1:
            return numbers.reshape(shape, order="F")
        if last:
            return numbers.reshape((*shape, channels), order="F")
        return np.moveaxis(numbers.reshape((channels, *shape), order="F"), 0, -1)

    return read


def number_or_nan(text: str | None) -> float:
    """Return a number; NaN if a text is none."""
    try:
        return float(text) if text else np.nan
    except ValueError:
        return np.nan


def decode_header(data: bytes) -> str:
    """Return the text of a header's line, in UTF-8 or else in Latin-1."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def data_files(path: Path, field_name: str, source: str, names: Sequence[str]) -> list[Path]:
    """Return the data files that a header names: by a name, a pattern, or a LIST of ``names``."""
    words = source.split()
    if words[:1] == ["LIST"]:
        return [_existing_file(path, field_name, each) for each in names]
    if "%" not in source or (path.parent / source).is_file():
        return [_existing_file(path, field_name, source)]
    numbers = [int(word) for word in words[1:4]]
    first, last, step = (*numbers, 1)[:3] if len(numbers) >= 2 else (0, -1, 1)
    if step == 0 or not _PATTERN.fullmatch(words[0]) or (last - first) // step + 1 > MAX_FILES:
        raise ConfigurationError(
            f"{path}: {field_name}: {source!r} is not allowed; a pattern such as "
            "slice%03d.raw is followed by its first and last number and perhaps the step"
        )
    stop = last + (1 if step > 0 else -1)
    return [
        _existing_file(path, field_name, words[0] % number) for number in range(first, stop, step)
    ]


def _existing_file(path: Path, field_name: str, name: str) -> Path:
    beside = path.parent / name
    if "\0" in name or not name or not beside.is_file():
        raise ConfigurationError(f"{path}: {field_name}: there is no file {name!r}")
    return beside
