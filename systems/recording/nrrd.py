"""Volumes as NRRD files, which 3D Slicer, ITK and others read."""

import io
import tempfile
import warnings
from pathlib import Path
from typing import Any

import nrrd
import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.recording.files import write_atomically
from sonoservo.systems.recording.volume_file import (
    LARGEST_HEADER,
    DataSection,
    VolumeFile,
    check_layout,
    one_line,
)
from sonoservo.systems.typed_yaml import ConfigurationError
from sonoservo.systems.ultrasound.volume import Volume

_SPACES = {
    "left-posterior-superior": (1, 1, 1),
    "lps": (1, 1, 1),
    "right-anterior-superior": (-1, -1, 1),
    "ras": (-1, -1, 1),
    "left-anterior-superior": (1, -1, 1),
    "las": (1, -1, 1),
}
"""Signs that turn a space's axes into LPS; other spaces name no directions of the body."""

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
"""Bytes that are turned round at a time where a file has the list axis first."""


def write_volume(path: str | Path, volume: Volume) -> Path:
    """Write a volume as NRRD, compressed with gzip, in mm, in the space LPS.

    The axes of the probe frame P become those of the patient that the format speaks of, as if the
    probe stood upright on the front of a patient who lies on the back: X of P (along the array) is
    L, to the patient's left; Y of P (depth) is P, to the back; Z of P (the sweep) is S, to the
    head. So a voxel lies at 1000 times its position in P.

    Parameters
    ----------
    path
        Where to; the suffix is usually ``.nrrd``.
    volume
        What to write.

    Returns
    -------
    The path.
    """
    buffer = io.BytesIO()
    header = {
        "space": "left-posterior-superior",
        "space directions": np.diag(1e3 * volume.spacing),
        "space origin": 1e3 * volume.origin,
        "space units": ["mm", "mm", "mm"],
        "kinds": ["domain", "domain", "domain"],
        "encoding": "gzip",
    }
    nrrd.write(buffer, volume.intensities, header, compression_level=1, index_order="F")
    return write_atomically(path, buffer.getvalue())


def open_nrrd(path: Path) -> VolumeFile:
    """Open a NRRD file with one volume, or with a sequence of them along an axis of its own.

    The list axis comes first, as 3D Slicer wrote it for years, or last, as it does now. What lies
    first in the file changes fastest, so a file with the list axis first is turned round once, into
    a temporary file. Raw data and gzip are read; others are refused.

    Raises
    ------
    ConfigurationError
        Naming the file and the fault.
    """
    text, offset = _read_header(path)
    try:
        # The parser warns of keys that come twice; the last one counts.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            header = nrrd.read_header(io.BytesIO(text))
        return _describe(path, header, offset)
    except ConfigurationError:
        raise
    except (
        nrrd.NRRDError,
        ValueError,
        KeyError,
        IndexError,
        TypeError,
        AttributeError,
        ArithmeticError,
    ) as error:
        raise ConfigurationError(
            f"{path}: its header is not valid NRRD: {one_line(error)}"
        ) from error


def _read_header(path: Path) -> tuple[bytes, int]:
    """Return the header's text, and where what follows it begins."""
    lines, size = [], 0
    with path.open("rb") as file:
        if not file.read(8).startswith(b"NRRD000"):
            raise ConfigurationError(f"{path}: no NRRD file: it does not begin with NRRD000")
        file.seek(0)
        while line := file.readline(LARGEST_HEADER):
            size += len(line)
            if size > LARGEST_HEADER:
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
            f"{path}: axes of the kinds {header.get('kinds', len(sizes) * ['domain'])}; a volume "
            "has three in space, a sequence of volumes a list besides, first or last"
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
        raise ConfigurationError(f"{path}: encoding: {encoding!r} is not read; raw and gzip are")
    size = nx * ny * nz * count * dtype.itemsize
    source = _data_file(path, header)
    data = DataSection(
        source or path,
        0 if source else offset,
        size,
        compression="gzip" if encoding.startswith("gz") else "",
    )
    if listed == 0 and count > 1:
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
    """Whether an axis lies in space; by its kind, or else by whether it has a direction."""
    kinds = header.get("kinds")
    if kinds is not None and str(kinds[axis]).lower() not in ("???", "none"):
        return str(kinds[axis]).lower() in ("domain", "space")
    directions = header.get("space directions")
    return directions is None or bool(np.isfinite(np.asarray(directions[axis], float)).all())


def _geometry(
    path: Path, header: dict[str, Any], spatial: list[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(3, 3) steps along the axes, as columns, and (3,) origin, in mm, in LPS."""
    space = str(header.get("space", "")).lower().removesuffix("-time")
    signs = np.array(_SPACES.get(space, (1, 1, 1)))
    units = header.get("space units", ["mm"] * 3)
    scales = [_MM.get(str(unit).strip('"')) for unit in units]
    if len(scales) < 3 or None in scales[:3]:
        raise ConfigurationError(f"{path}: space units: {units} are not allowed; mm, cm, m or um")
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
    """Return where the voxels lie if not in the header's own file."""
    name = header.get("data file", header.get("datafile"))
    if name is None:
        return None
    source = path.parent / str(name)
    skip = [key for key in ("byte skip", "line skip", "byteskip", "lineskip") if header.get(key)]
    if skip or str(name).startswith("LIST") or "%" in str(name):
        raise ConfigurationError(f"{path}: data file: only one file without any skip is read")
    if not source.is_file():
        raise ConfigurationError(f"{path}: data file: there is no file {source}")
    return source


def _times(
    path: Path, header: dict[str, Any], listed: int, count: int
) -> NDArray[np.float64] | None:
    """Times of the volumes in s, from the index values of 3D Slicer; None if they are none."""
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
    """Copy data whose list axis runs fastest to a temporary file in which it runs slowest."""
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
        # The open file outlives its name.
        return DataSection(Path(file.name), 0, voxels * size)
