"""Reader of volumes from NRRD files, which 3D Slicer, ITK and others write."""

import io
import tempfile
import warnings
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import (
    MAX_HEADER,
    DataSection,
    VolumeFile,
    check_layout,
)

SPACES = {
    "left-posterior-superior": (1, 1, 1),
    "lps": (1, 1, 1),
    "right-anterior-superior": (-1, -1, 1),
    "ras": (-1, -1, 1),
    "left-anterior-superior": (1, -1, 1),
    "las": (1, -1, 1),
}
"""Signs that turn a space's axes into LPS; other spaces are not anatomical."""

_MM = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "": 1.0}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}

_TYPES = {
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i1": ("signed char", "int8", "int8_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "f4": ("float",),
    "f8": ("double",),
}
_CODES = {name: code for code, names in _TYPES.items() for name in names}

_BLOCK = 1 << 26
"""Bytes transposed at a time if a file has the list axis first."""


def open_nrrd(path: Path) -> VolumeFile:
    """Open an NRRD file with one volume, or with a sequence of them along a list axis.

    The list axis may come first, as older versions of 3D Slicer wrote it, or last, as it is written
    today. The first axis of a file varies fastest, so a file with the list axis first is transposed
    once into a temporary file. Raw and gzip data are supported.

    Raises
    ------
    ConfigurationError
        If the file is not valid or not supported; the message names the file and the fault.
    """
    text, offset = _read_header(path)
    # The parser warns of duplicate keys; the last one counts.
    with refusing_failures(path, "its header is not valid NRRD"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _describe(path, nrrd.read_header(io.BytesIO(text)), offset)


def _read_header(path: Path) -> tuple[bytes, int]:
    """Return the header's text, and the offset of the first byte after the header."""
    lines, size = [], 0
    with path.open("rb") as file:
        if not file.read(8).startswith(b"NRRD000"):
            raise ConfigurationError(f"{path}: not an NRRD file: it does not begin with NRRD000")
        file.seek(0)
        while line := file.readline(MAX_HEADER):
            size += len(line)
            if size > MAX_HEADER:
                raise ConfigurationError(f"{path}: its header has no end")
            lines.append(line)
            if not line.strip():
                break
        return b"".join(lines), file.tell()


def _describe(path: Path, header: dict[str, Any], offset: int) -> VolumeFile:
    sizes = [int(n) for n in header["sizes"]]
    if len(sizes) != int(header["dimension"]):
        raise ConfigurationError(f"{path}: {len(sizes)} sizes for {header['dimension']} dimensions")
    space = [_is_space(header, axis) for axis in range(len(sizes))]
    lists = [axis for axis, spatial in enumerate(space) if not spatial]
    if len(sizes) - len(lists) != 3 or len(lists) > 1 or (lists and lists[0] not in (0, 3)):
        raise ConfigurationError(
            f"{path}: kinds: {header.get('kinds', len(sizes) * ['domain'])} is not allowed; a "
            "volume has three in space, a sequence also has a list axis, first or last"
        )
    listed = lists[0] if lists else None
    spatial = [axis for axis in range(len(sizes)) if axis != listed]
    nx, ny, nz = (sizes[axis] for axis in spatial)
    count = 1 if listed is None else sizes[listed]
    directions, origin = _geometry(path, header, spatial)
    check_layout(path, (nx, ny, nz), count, directions)
    if header["type"] not in _CODES:
        raise ConfigurationError(f"{path}: type: {header['type']!r} is not allowed")
    big = str(header.get("endian", "little")).lower() == "big"
    dtype = np.dtype((">" if big else "<") + _CODES[header["type"]])
    encoding = str(header.get("encoding")).lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise ConfigurationError(
            f"{path}: encoding: {encoding!r} is not supported; use raw or gzip"
        )
    size = nx * ny * nz * count * dtype.itemsize
    source = _data_file(path, header)
    data = DataSection(
        source or path,
        0 if source else offset,
        size,
        compression="gzip" if encoding.startswith("gz") else "",
    )
    if listed == 0 and count > 1:
        require_memory(size, str(path), f"{count} volumes with the list axis first")
        data = _turned_round(data, nx * ny * nz, count, dtype.itemsize)

    def read(number: int) -> NDArray[Any]:
        volume = nx * ny * nz * dtype.itemsize
        voxels = np.frombuffer(data.read(number * volume, volume), dtype)
        return voxels.reshape((nx, ny, nz), order="F")

    return VolumeFile(
        path,
        (nx, ny, nz),
        count,
        directions,
        origin,
        read,
        None if listed is None else _times(path, header, listed, count),
        {str(key): str(value) for key, value in header.items()},
    )


def _is_space(header: dict[str, Any], axis: int) -> bool:
    """Return True if an axis is spatial, judged by its kind or else by its direction."""
    kinds = header.get("kinds")
    if kinds is not None and str(kinds[axis]).lower() not in ("???", "none"):
        return str(kinds[axis]).lower() in ("domain", "space")
    directions = header.get("space directions")
    return directions is None or bool(np.isfinite(np.asarray(directions[axis], float)).all())


def _geometry(
    path: Path, header: dict[str, Any], spatial: list[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (3, 3) steps along the axes as columns, and the (3,) origin, in mm, in LPS."""
    space = str(header.get("space", "")).lower().removesuffix("-time")
    signs = np.array(SPACES.get(space, (1, 1, 1)))
    units = header.get("space units", ["mm"] * 3)
    scales = [_MM.get(str(unit).strip('"')) for unit in units]
    if len(scales) < 3 or None in scales[:3]:
        raise ConfigurationError(
            f"{path}: space units: {units} are not allowed; use mm, cm, m or um"
        )
    scale = signs * np.array(scales[:3], float)
    if "space directions" in header:
        rows = np.array([np.asarray(header["space directions"][axis], float) for axis in spatial])
        directions = rows.T.reshape(3, 3) * scale[:, np.newaxis]
    else:
        spacings = np.asarray(header.get("spacings", np.ones(len(spatial) + 1)), float)
        directions = np.diag(spacings[spatial])
    origin = np.asarray(header.get("space origin", np.zeros(3)), float).reshape(3) * scale
    if not np.isfinite(origin).all():
        raise ConfigurationError(f"{path}: space origin: it must be finite")
    return directions, origin


def _data_file(path: Path, header: dict[str, Any]) -> Path | None:
    """Return the path of the voxels' file; None if they follow the header."""
    name = header.get("data file", header.get("datafile"))
    if name is None:
        return None
    source = path.parent / str(name)
    skip = [key for key in ("byte skip", "line skip", "byteskip", "lineskip") if header.get(key)]
    if skip or str(name).startswith("LIST") or "%" in str(name):
        raise ConfigurationError(
            f"{path}: data file: only a single file without byte or line skip is supported"
        )
    if not source.is_file():
        raise ConfigurationError(f"{path}: data file: there is no file {source}")
    return source


def _times(
    path: Path, header: dict[str, Any], listed: int, count: int
) -> NDArray[np.float64] | None:
    """Return the volumes' times in s from 3D Slicer's index values; None if those are not times."""
    values = header.get(f"axis {listed} index values")
    label = str(_entry(header, "labels", listed)).strip('"').lower()
    unit = str(_entry(header, "units", listed)).strip('"').lower()
    unit = str(header.get(f"axis {listed} index units", unit)).lower()
    scale = _SECONDS.get(unit)
    if values is None or not (scale or label == "time"):
        return None
    times = np.array(str(values).split(), float) * (scale or 1.0)
    if len(times) != count:
        raise ConfigurationError(f"{path}: {len(times)} index values for {count} volumes")
    return times


def _entry(header: dict[str, Any], name: str, axis: int) -> Any:
    entries = header.get(name)
    return entries[axis] if entries is not None and len(entries) > axis else ""


def _turned_round(data: DataSection, voxels: int, count: int, itemsize: int) -> DataSection:
    """Copy data whose list axis varies fastest to a temporary file in which it varies slowest."""
    with tempfile.NamedTemporaryFile(prefix="sonoservo-") as file:
        step = max(1, _BLOCK // (count * itemsize))
        for first in range(0, voxels, step):
            number = min(step, voxels - first)
            size = count * itemsize
            block = np.frombuffer(data.read(first * size, number * size), f"V{itemsize}")
            for k, column in enumerate(block.reshape(number, count).T):
                file.seek((k * voxels + first) * itemsize)
                file.write(column.tobytes())
        file.flush()
        # The open file remains readable after its name is removed.
        return DataSection(Path(file.name), 0, voxels * size)
