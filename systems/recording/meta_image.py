"""Reader of MetaImage files (``.mha``, ``.mhd``), which ITK, 3D Slicer and PLUS write.

The format is simple enough to read directly. SimpleITK 2.5 crashes with a segmentation fault on a
header such as ``NDims = -1``; the tests use it as a reference.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import (
    MAX_HEADER,
    DataSection,
    VolumeFile,
    check_layout,
)

_TYPES = {
    "MET_UCHAR": "u1",
    "MET_CHAR": "i1",
    "MET_USHORT": "u2",
    "MET_SHORT": "i2",
    "MET_UINT": "u4",
    "MET_INT": "i4",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}

_ORIGIN = ("Offset", "Position", "Origin")
_DIRECTIONS = ("TransformMatrix", "Rotation", "Orientation")
_BIG_ENDIAN = ("BinaryDataByteOrderMSB", "ElementByteOrderMSB")
"""Alternative names of each field; the first one present counts."""


def open_meta_image(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open a MetaImage file with one volume, or with a sequence of them along a fourth axis.

    PLUS also stores tracked 2D frames in such files, one after the other along the third axis.

    Parameters
    ----------
    path
        Path of the file.
    frames
        Whether to open 2D frames and refuse volumes, rather than the reverse.

    Raises
    ------
    ConfigurationError
        If the file is not valid; the message names the file and the fault.
    """
    with refusing_failures(path, "its header is not valid"):
        return _describe(path, *_read_header(path), frames)


def _describe(path: Path, fields: dict[str, str], offset: int, frames: bool) -> VolumeFile:
    sizes = [int(n) for n in _numbers(path, fields, ("DimSize",))]
    n = len(sizes)
    if n not in (3, 4):
        raise ConfigurationError(
            f"{path}: DimSize: {fields['DimSize']!r} is not allowed; a volume has 3 axes, "
            "a sequence of volumes 4"
        )
    if n == 3 and sum(key.endswith("_Timestamp") for key in fields) > 1:
        sizes = [*sizes[:2], 1, sizes[2]]  # frames, one after the other
    nx, ny, nz, count = (*sizes, 1)[:4]
    kind = fields.get("ElementType", "")
    if kind not in _TYPES or fields.get("ElementNumberOfChannels", "1") != "1":
        raise ConfigurationError(
            f"{path}: ElementType: {kind!r} is not allowed; a voxel is one number of the types "
            f"{', '.join(_TYPES)}"
        )
    if not _flag(fields, ("BinaryData",), True):
        raise ConfigurationError(f"{path}: BinaryData: voxels stored as text are not supported")
    # A row of the matrix is the direction of an axis.
    matrix = _numbers(path, fields, _DIRECTIONS, np.eye(n).ravel(), n * n).reshape(n, n)
    steps = _numbers(path, fields, ("ElementSpacing", "ElementSize"), np.ones(n), n)
    origin = _numbers(path, fields, _ORIGIN, np.zeros(n), n)
    directions = matrix[:3, :3].T * steps[:3]
    check_layout(path, (nx, ny, nz), count, directions, frames=frames)
    dtype = np.dtype((">" if _flag(fields, _BIG_ENDIAN, False) else "<") + _TYPES[kind])
    voxels = nx * ny * nz
    data = _open_data(path, fields, offset, voxels * count * dtype.itemsize)

    def read(number: int) -> NDArray[Any]:
        size = voxels * dtype.itemsize
        return np.frombuffer(data.read(number * size, size), dtype).reshape((nx, ny, nz), order="F")

    return VolumeFile(path, (nx, ny, nz), count, directions, origin[:3], read, None, fields)


def _read_header(path: Path) -> tuple[dict[str, str], int]:
    """Return the header's fields, and the offset of the first byte after the header."""
    fields: dict[str, str] = {}
    with path.open("rb") as file:
        while "ElementDataFile" not in fields:
            line = file.readline(1 << 16)
            key, equals, value = line.decode("latin-1").partition("=")
            if not equals or file.tell() > MAX_HEADER:
                raise ConfigurationError(f"{path}: not a MetaImage file, or its header has no end")
            fields[key.strip()] = value.strip()
        return fields, file.tell()


def _numbers(
    path: Path,
    fields: dict[str, str],
    names: tuple[str, ...],
    default: NDArray[np.float64] | None = None,
    count: int | None = None,
) -> NDArray[np.float64]:
    """Return the numbers of a field, which must be finite and, if given, `count` in number."""
    name = next((name for name in names if name in fields), names[0])
    if name not in fields and default is not None:
        return default
    try:
        numbers = np.array(fields.get(name, "").split(), float)
    except ValueError:
        numbers = np.array([np.nan])
    right = len(numbers) == count if count is not None else len(numbers) > 0
    if not right or not np.isfinite(numbers).all():
        raise ConfigurationError(f"{path}: {name}: {fields.get(name, '')!r} is not allowed")
    return numbers


def _flag(fields: dict[str, str], names: tuple[str, ...], default: bool) -> bool:
    for name in names:
        if name in fields:
            return fields[name][:1].lower() in ("t", "1")
    return default


def _open_data(path: Path, fields: dict[str, str], offset: int, size: int) -> DataSection:
    source = fields["ElementDataFile"]
    if source.upper() != "LOCAL":
        beside = path.parent / source
        if "\0" in source or source.startswith("LIST") or not beside.is_file():
            raise ConfigurationError(f"{path}: ElementDataFile: there is no file {source!r}")
        path, offset = beside, 0
    skip = fields.get("HeaderSize", "0")
    if skip == "-1":  # the voxels are the last bytes
        offset = max(path.stat().st_size - size, 0)
    elif skip.isdecimal() and len(skip) < 18:
        offset += int(skip)
    else:
        raise ConfigurationError(f"{path}: HeaderSize: {skip!r} is not allowed")
    compressed = _flag(fields, ("CompressedData",), False)
    return DataSection(path, offset, size, compression="zlib" if compressed else "")
