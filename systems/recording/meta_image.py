"""Reader of MetaImage files (``.mha``, ``.mhd``), which ITK, 3D Slicer and PLUS write.

The format is simple enough to read directly. SimpleITK 2.5 crashes with a segmentation fault on a
header such as ``NDims = -1``; the tests use it as a reference.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.plus_fields import (
    numbered_fields,
    refuse_misspelt,
    sequence_field,
    unknown_fields,
)
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import (
    MAX_FILES,
    MAX_HEADER,
    MAX_STEP,
    MILLIMETRES,
    DataSections,
    FieldUse,
    VolumeFile,
    check_layout,
    data_files,
    decode_header,
    open_data,
    voxel_reader,
)

_TYPES = {
    "MET_UCHAR": "u1",
    "MET_CHAR": "i1",
    "MET_USHORT": "u2",
    "MET_SHORT": "i2",
    "MET_UINT": "u4",
    "MET_INT": "i4",
    "MET_ULONG_LONG": "u8",
    "MET_LONG_LONG": "i8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}

_ORIGIN = ("Offset", "Position", "Origin")
_DIRECTIONS = ("TransformMatrix", "Rotation", "Orientation")
_BIG_ENDIAN = ("BinaryDataByteOrderMSB", "ElementByteOrderMSB")
# Alternative names of each field; the first one present counts.
_SPACING = ("ElementSpacing", "ElementSize")
_ALTERNATIVES = tuple(map(frozenset, (_ORIGIN, _DIRECTIONS, _BIG_ENDIAN, _SPACING)))
FIELDS = {
    **dict.fromkeys(
        (
            "NDims", "DimSize", "ElementType", "ElementNumberOfChannels", "ElementDataFile",
            "HeaderSize", "CompressedData", "DistanceUnits", "decibels_per_level",
            "ElementToIntensityFunctionSlope", "ElementToIntensityFunctionOffset",
            *_ORIGIN, *_DIRECTIONS, *_BIG_ENDIAN, *_SPACING,
        ),
        FieldUse.USED,
    ),
    **dict.fromkeys(("ObjectType", "BinaryData", "HeaderSizePerSlice"), FieldUse.CHECKED),
    **dict.fromkeys(
        (
            "ObjectSubType", "Comment", "TransformType", "Name", "ID", "ParentID", "Color",
            "CompressedDataSize", "CompressionLevel", "CenterOfRotation", "AnatomicalOrientation",
            "Modality", "SequenceID", "ElementMin", "ElementMax", "ElementNBits", "Kinds",
            "AcquisitionDate", "ITK_InputFilterName",
        ),
        FieldUse.NO_EFFECT,
    ),
}  # fmt: skip
"""Fields of the format, and what becomes of them; those of PLUS are the `plus_fields`."""


def open_meta_image(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open a MetaImage file with one volume, or with a sequence of them along a fourth axis."""
    with refusing_failures(path, "its header is not valid"):
        return _describe(path, *_read_header(path), frames)


def _describe(
    path: Path, fields: dict[str, str], names: list[str], offset: int, frames: bool
) -> VolumeFile:
    given = set().union(*(each for each in _ALTERNATIVES if not each.isdisjoint(fields)))
    refuse_misspelt(path, fields, FIELDS, given)
    sizes = [int(n) for n in _numbers(path, fields, ("DimSize",))]
    n = len(sizes)
    if n not in (3, 4):
        raise ConfigurationError(
            f"{path}: DimSize: {fields['DimSize']!r} is not allowed; a volume has 3 axes, "
            "a sequence of volumes 4"
        )
    if fields.get("NDims", str(n)) != str(n):
        raise ConfigurationError(
            f"{path}: NDims: {fields['NDims']!r} is not allowed; DimSize has {n} axes"
        )
    if fields.get("ObjectType", "Image").lower() != "image":
        raise ConfigurationError(f"{path}: ObjectType: {fields['ObjectType']!r} is no Image")
    stated = n
    numbers = {match[1] for key in fields if (match := re.match(r"Seq_Frame0*(\d+)_", key))}
    if n == 3 and len(numbers) > 1:
        sizes = [*sizes[:2], 1, sizes[2]]  # frames, one after the other
    nx, ny, nz, count = (*sizes, 1)[:4]
    kind, channels = fields.get("ElementType", ""), _channels(path, fields)
    if kind not in _TYPES:
        raise ConfigurationError(
            f"{path}: ElementType: {kind!r} is not allowed; a voxel is one number of the types "
            f"{', '.join(_TYPES)}"
        )
    if not _flag(fields, ("BinaryData",), True):
        raise ConfigurationError(f"{path}: BinaryData: voxels stored as text are not supported")
    unit = MILLIMETRES.get(fields.get("DistanceUnits", "").strip('"').lower())
    if unit is None:
        raise ConfigurationError(
            f"{path}: DistanceUnits: {fields['DistanceUnits']!r} is not allowed; use mm, cm or um"
        )
    # A row of the matrix is the direction of an axis.
    matrix = _numbers(path, fields, _DIRECTIONS, np.eye(n).ravel(), n * n).reshape(n, n)
    steps = _numbers(path, fields, _SPACING, np.ones(n), n)
    origin = _numbers(path, fields, _ORIGIN, np.zeros(n), n)
    directions = matrix[:3, :3].T * steps[:3] * unit
    check_layout(path, (nx, ny, nz), count, directions, frames=frames)
    dtype = np.dtype((">" if _flag(fields, _BIG_ENDIAN, False) else "<") + _TYPES[kind])
    size = nx * ny * nz * channels * dtype.itemsize
    data = _open_data(path, fields, names, offset, size * count)
    slope, shift = (
        float(_numbers(path, fields, (f"ElementToIntensityFunction{each}",), default, 1)[0])
        for each, default in (("Slope", np.ones(1)), ("Offset", np.zeros(1)))
    )
    read = voxel_reader(data, dtype, (nx, ny, nz), channels)

    def rescaled(number: int) -> NDArray[Any]:
        return read(number) * slope + shift

    fields = numbered_fields(fields, FIELDS, count)
    notes = [*data.notes(), *unknown_fields("MetaImage", fields, FIELDS)]
    if not frames:
        if not any(name in fields for name in _SPACING):
            notes.append("it states no spacing; 1 mm is taken")
        if not any(name in fields for name in _ORIGIN):
            notes.append("it states no position; its first voxel is taken to lie at 0")
    times = None
    if stated == 4 and not frames and 0 < steps[3] <= MAX_STEP and steps[3] != 1.0:
        # PLUS states each volume's time instead, and leaves the spacing at 1.
        times = origin[3] + steps[3] * np.arange(count)
        if "Seq_Frame0000_Timestamp" not in fields:
            notes.append(f"its volumes are {steps[3]:g} s apart, by the spacing of its fourth axis")
    return VolumeFile(
        path, (nx, ny, nz), count, directions, origin[:3] * unit,
        read if (slope, shift) == (1.0, 0.0) else rescaled, times, fields,
        tuple(notes), channels,
    )  # fmt: skip


def _channels(path: Path, fields: Mapping[str, str]) -> int:
    text = fields.get("ElementNumberOfChannels", "1")
    if text not in ("1", "3", "4"):
        raise ConfigurationError(
            f"{path}: ElementNumberOfChannels: {text!r} is not allowed; a voxel is one number, or "
            "3 or 4 for colours"
        )
    return int(text)


def _read_header(path: Path) -> tuple[dict[str, str], list[str], int]:
    """Return the fields, the listed data files, and the offset of the first byte after them."""
    fields: dict[str, str] = {}
    with path.open("rb") as file:
        while "ElementDataFile" not in fields:
            line = file.readline(1 << 16)
            if fields and line.strip() == b"":
                if not line:
                    raise ConfigurationError(f"{path}: its header has no ElementDataFile")
                continue
            key, equals, value = decode_header(line).partition("=")
            if fields and not equals:
                raise ConfigurationError(
                    f"{path}: {key.strip()[:60]}: it has no value; fields are NAME = VALUE"
                )
            if not equals or file.tell() > MAX_HEADER:
                raise ConfigurationError(f"{path}: not a MetaImage file, or its header has no end")
            fields[key.strip()] = value.strip()
        offset = file.tell()
        names: list[str] = []
        if fields["ElementDataFile"].split()[:1] == ["LIST"]:
            for line in file:
                if len(names) > MAX_FILES or file.tell() > MAX_HEADER:
                    raise ConfigurationError(f"{path}: ElementDataFile: the list has no end")
                if line.strip():
                    names.append(decode_header(line).strip())
        return fields, names, offset


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
        words = fields.get(name, "").split()
        comma = any(re.fullmatch(r"-?\d+,\d+", word) for word in words)
        raise ConfigurationError(
            f"{path}: {name}: {fields.get(name, '')!r} is not allowed; expected finite numbers: "
            f"{count or '3 or 4'}{', with a comma for a point?' if comma else ''}"
        )
    return numbers


def _flag(fields: dict[str, str], names: tuple[str, ...], default: bool) -> bool:
    for name in names:
        if name in fields:
            return fields[name][:1].lower() in ("t", "1")
    return default


def _open_data(
    path: Path, fields: dict[str, str], names: list[str], offset: int, size: int
) -> DataSections:
    compressed = _flag(fields, ("CompressedData",), False)
    source, field = fields["ElementDataFile"], "ElementDataFile"
    local = source.upper() == "LOCAL"
    files = [path] if local else data_files(path, field, source, names)
    offset = offset if local else 0
    skip = fields.get("HeaderSize", "0")
    if skip != "-1" and not (skip.isdecimal() and len(skip) < 18):
        raise ConfigurationError(f"{path}: HeaderSize: {skip!r} is not allowed")
    if sequence_field(fields, "HeaderSizePerSlice") not in ("", "0"):
        raise ConfigurationError(f"{path}: HeaderSizePerSlice: bytes between slices are not read")
    if compressed and len(files) > 1:
        raise ConfigurationError(f"{path}: {field}: several compressed files are not supported")

    def first(file: Path, each: int) -> int:
        # With -1, the voxels are the last bytes.
        return max(file.stat().st_size - each, 0) if skip == "-1" else offset + int(skip)

    return open_data(path, field, files, size, first, compressed=compressed)
