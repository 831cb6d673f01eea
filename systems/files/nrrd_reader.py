"""Reader of volumes from NRRD files, which 3D Slicer, ITK, PLUS and others write."""

import re
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.plus_fields import numbered_fields, refuse_misspelt, unknown_fields
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import (
    MAX_FILES,
    MAX_HEADER,
    MAX_STEP,
    MILLIMETRES,
    SECONDS,
    DataSection,
    DataSections,
    FieldUse,
    HoldsFramesError,
    VolumeFile,
    check_layout,
    data_files,
    decode_header,
    open_data,
    voxel_reader,
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

# Right-handed spaces whose axes have no anatomical names. They are taken as LPS, with a note.
_NAMELESS = ("scanner-xyz", "3d-right-handed")
FIELDS = {
    **dict.fromkeys(
        (
            "dimension", "type", "encoding", "endian", "sizes", "space", "space units",
            "space origin", "space directions", "spacings", "axis mins", "axis maxs", "centers",
            "units", "labels", "kinds", "data file", "line skip", "byte skip",
        ),
        FieldUse.USED,
    ),
    "space dimension": FieldUse.CHECKED,
    **dict.fromkeys(
        (
            "content", "number", "block size", "old min", "old max", "thicknesses", "sample units",
            "measurement frame",
        ),
        FieldUse.NO_EFFECT,
    ),
}  # fmt: skip
"""Fields of the format, and what becomes of them."""

KEYS = {
    "index values": FieldUse.USED,
    "index units": FieldUse.USED,
    "index type": FieldUse.NO_EFFECT,
    "decibels_per_level": FieldUse.USED,
    "DataNodeClassName": FieldUse.NO_EFFECT,
}
"""Keys of 3D Slicer and this program, and what becomes of them; the first three follow ``axis N``.
Those of PLUS are the `plus_fields`."""

_NAMES = {name.replace(" ", ""): name for name in FIELDS} | {"centerings": "centers"}

_TYPES = {
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i1": ("signed char", "int8", "int8_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "u8": (
        "ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t",
    ),
    "i8": (
        "longlong", "long long", "long long int", "signed long long", "signed long long int",
        "int64", "int64_t",
    ),
    "f4": ("float",),
    "f8": ("double",),
}  # fmt: skip
_CODES = {name: code for code, names in _TYPES.items() for name in names}

# Kinds of axes that may hold red, green, blue and perhaps opacity: ITK calls colours vectors.
_COLOURS = {
    "rgb-color": 3, "rgba-color": 4, "3-color": 3, "4-color": 4, "vector": 3, "3-vector": 3,
    "4-vector": 4,
}  # fmt: skip
_AXIS = re.compile(r"axis \d+ (?=index)")

_BLOCK = 1 << 26  # Bytes transposed at a time if a file has its list or colours first


def open_nrrd(path: Path, *, frames: bool = False) -> VolumeFile:
    """Open an NRRD file with one volume, 2D frames, or a sequence along a list axis."""
    with refusing_failures(path, "its header is not valid NRRD"):
        header, names, offset = _read_header(path)
        return _Reader(path, header, names, offset, frames).describe()


def _read_header(path: Path) -> tuple[dict[str, str], list[str], int]:
    """Return the fields, the listed data files, and the offset of the first byte after them."""
    fields: dict[str, str] = {}
    keys: dict[str, str] = {}
    names: list[str] = []
    with path.open("rb") as file:
        if not re.fullmatch(rb"NRRD000\d\s*", file.readline(99)):
            raise ConfigurationError(f"{path}: not an NRRD file: it does not begin with NRRD000")
        while raw := file.readline(MAX_HEADER):
            if file.tell() > MAX_HEADER:
                raise ConfigurationError(f"{path}: its header has no end")
            line = decode_header(raw).rstrip("\r\n")
            if fields.get("data file", "").startswith("LIST"):
                if line.strip():
                    names.append(line.strip())
                if len(names) > MAX_FILES:
                    raise ConfigurationError(f"{path}: data file: more than {MAX_FILES} files")
                continue
            if not line:
                break
            if not line.startswith("#"):
                _add_field(path, fields, keys, line)
        refuse_misspelt(path, fields, FIELDS)
        refuse_misspelt(path, dict.fromkeys(_AXIS.sub("", key) for key in keys), KEYS)
        return fields | keys, names, file.tell()


def _add_field(path: Path, fields: dict[str, str], keys: dict[str, str], line: str) -> None:
    field, colon, value = line.partition(": ")
    key, equals, text = line.partition(":=")
    if equals and len(key) < len(field):
        keys[key] = text.strip()  # of keys, the last one counts
        return
    if not colon:
        field, colon, value = line.partition(":")
    name = field.strip().lower()
    name = _NAMES.get(name.replace(" ", ""), name)
    if not colon:
        raise ConfigurationError(f"{path}: {line[:60]!r} is no field of an NRRD header")
    value = value.strip()
    if fields.setdefault(name, value) != value:
        raise ConfigurationError(
            f"{path}: {name}: it stands twice, as {fields[name]!r} and as {value!r}"
        )


class _Reader:
    """Header of a file, and the volumes that it describes."""

    def __init__(
        self, path: Path, header: Mapping[str, str], names: list[str], offset: int, frames: bool
    ) -> None:
        self.path, self.header, self.names = path, header, names
        self.offset, self.frames = offset, frames
        if not re.fullmatch(r"\d+(\s+\d+)*", header.get("sizes", "")):
            raise self.refuse("sizes", "a number of samples is expected for each axis")
        self.sizes = [int(n) for n in header["sizes"].split()]
        self.notes: list[str] = []

    def refuse(self, field: str, text: str = "") -> ConfigurationError:
        value = f"{self.header[field]!r} is not allowed; " if field in self.header else ""
        return ConfigurationError(f"{self.path}: {field}: {value}{text}".removesuffix("; "))

    def describe(self) -> VolumeFile:
        header, sizes = self.header, self.sizes
        if header.get("dimension") != str(len(sizes)):
            raise self.refuse("dimension", f"it is the number of sizes, {len(sizes)}")
        if len(sizes) < 3:
            raise self.refuse("sizes", "it is one image; a volume has three axes in space")
        spatial, listed, coloured = self._axes()
        nx, ny, nz = (*(sizes[axis] for axis in spatial), 1)[:3]
        shape = (nx, ny, nz)
        count = 1 if listed is None else sizes[listed]
        channels = 1 if coloured is None else sizes[coloured]
        directions, origin = self._geometry(spatial)
        check_layout(self.path, shape, count, directions, frames=self.frames)
        kind = header.get("type", "").lower()
        if kind not in _CODES:
            raise self.refuse("type", f"use one of {', '.join(n[0] for n in _TYPES.values())}")
        endian = header.get("endian", "little").lower()
        if endian not in ("little", "big"):
            raise self.refuse("endian", "it is little or big")
        dtype = np.dtype((">" if endian == "big" else "<") + _CODES[kind])
        size = nx * ny * nz * count * channels * dtype.itemsize
        data = self._data(size)
        self.notes += data.notes()
        if listed == 0 and count > 1:
            require_memory(size, str(self.path), f"{count} volumes with the list axis first")
            data = _turned_round(data, nx * ny * nz, count, dtype.itemsize)
        times = None if listed is None else self._times(listed, count)
        fields = numbered_fields(header, FIELDS | KEYS, count)
        known = unknown_fields("NRRD", (_AXIS.sub("", name) for name in fields), FIELDS | KEYS)
        return VolumeFile(
            self.path, shape, count, directions, origin,
            voxel_reader(data, dtype, shape, channels, last=coloured != 0), times, fields,
            (*self.notes, *known), channels,
        )  # fmt: skip

    def entries(self, field: str) -> list[str]:
        """Return the words of a field with one for each axis; quoted words may hold blanks."""
        words = re.findall(r'"((?:[^"\\]|\\.)*)"|(\S+)', self.header.get(field, ""))
        return [quoted or plain for quoted, plain in words]

    def _axes(self) -> tuple[list[int], int | None, int | None]:
        """Return the axes in space, the list axis and that of the colours."""
        count = len(self.sizes)
        kinds = [each.lower() for each in self.entries("kinds")] or ["???"] * count
        if len(kinds) != count:
            raise self.refuse("kinds", f"{count} axes have as many kinds")
        vectors = self._vectors("space directions")
        listed, coloured, spatial = [], [], []
        for axis, kind in enumerate(kinds):
            none = vectors is not None and not np.isfinite(vectors[axis]).all()
            if kind in ("list", "time"):
                listed.append(axis)
            elif kind in _COLOURS or (kind in ("scalar", "stub") and self.sizes[axis] == 1):
                coloured.append(axis)
            elif kind in ("domain", "space") or (kind in ("???", "none") and not none):
                spatial.append(axis)
            elif kind in ("???", "none"):
                listed.append(axis)
            else:
                raise self.refuse(
                    "kinds", f"{kind}: vectors, and numbers that are no echoes, are not supported"
                )
        stamps = sum(name.endswith("_Timestamp") for name in self.header)
        # ITK writes time as a fourth axis in space. Frames with a time each lie along the third.
        if not listed and (len(spatial) == 4 or (len(spatial) == 3 and stamps > 1)):
            listed.append(spatial.pop())
        colours = [axis for axis in coloured if self.sizes[axis] > 1]
        if any(self.sizes[axis] not in (3, 4) for axis in colours):
            raise self.refuse("kinds", "several numbers a voxel are a vector; one is wanted")
        letters = "".join(
            "L" if axis in listed else "C" if axis in colours else "S" if axis in spatial else ""
            for axis in range(count)
        )
        if self.frames and re.fullmatch("C?SSL|SSCL", letters):
            return spatial, listed[0], next(iter(colours), None)
        if re.fullmatch("C?SSL|SSCL", letters):
            raise HoldsFramesError(
                f"{self.path}: {' x '.join(map(str, self.sizes))} numbers are 2D frames; make "
                "volumes of them with --reconstruct"
            )
        if not re.fullmatch("C?SSSL?|SSSCL?|LSSS", letters):
            raise ConfigurationError(
                f"{self.path}: kinds: {' '.join(kinds)!r} is not allowed; a volume has three axes "
                "in space, a sequence also has a list axis, last or, without colours, first; "
                "colours come right before or after the axes in space"
            )
        return spatial, next(iter(listed), None), next(iter(colours), None)

    def _vectors(self, field: str) -> NDArray[np.float64] | None:
        """Return (n, d) vectors of a field; rows of NaN stand for "none"."""
        if field not in self.header:
            return None
        found = re.findall(r"\(([^)]*)\)|(none)", self.header[field], re.IGNORECASE)
        rows = [[float(x) for x in inside.split(",")] if inside else [] for inside, _ in found]
        width = max(map(len, rows), default=0)
        if width == 0 or any(len(row) not in (0, width) for row in rows):
            raise self.refuse(field, "it holds vectors (x,y,z)")
        return np.array([row or [np.nan] * width for row in rows])

    def _scales(self) -> NDArray[np.float64]:
        """Return (3,) factors that turn the space's coordinates into mm in LPS."""
        name = self.header.get("space", "").strip().lower()
        base = name.removesuffix("-time")
        base = {"rast": "ras", "last": "las", "lpst": "lps"}.get(base, base)
        if name and base not in (*SPACES, *_NAMELESS):
            known = ", ".join(each for each in SPACES if "-" in each)
            raise self.refuse("space", f"the axes must have anatomical names: {known}")
        if base not in SPACES and "space directions" in self.header and not self.frames:
            said = f"its space {name!r} has" if name else "it names no space and has"
            self.notes.append(f"{said} no anatomical axes; they are taken as LPS")
        units = [each.strip().lower() for each in self.entries("space units")] or ["mm"] * 3
        scales = [MILLIMETRES.get(unit) for unit in units[:3]]
        if len(scales) < 2 or None in scales:
            raise ConfigurationError(
                f"{self.path}: space units: {units} are not allowed; use mm, cm, m or um"
            )
        scales = [*scales, 1.0][:3]
        return np.asarray(np.array(SPACES.get(base, (1, 1, 1)), float) * scales)

    def _geometry(self, spatial: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the (3, 3) steps along the axes as columns, and the (3,) origin, in mm, in LPS."""
        scale = self._scales()
        n = len(spatial)
        vectors = self._vectors("space directions")
        origins = self._vectors("space origin")
        directions, origin = np.eye(3), np.zeros(3)
        if vectors is not None:
            if len(vectors) != len(self.sizes):
                raise self.refuse("space directions", "one vector for each axis")
            said = int(self.header.get("space dimension", vectors.shape[1]))
            if said != vectors.shape[1] or not 2 <= said <= 4:
                raise self.refuse("space dimension", "vectors have 2, 3 or 4 numbers, as it says")
            width = min(said, 3)
            directions[:width, :n] = vectors[spatial, :width].T
            directions *= scale[:, np.newaxis]
            if n == 2:
                directions[:, 2] = [0, 0, 1] if width == 2 else np.cross(*directions[:, :2].T)
        else:
            steps, first = self._plain_grid(spatial)
            directions[:n, :n] = np.diag(steps * np.sign(scale[:n]))
            origin[:n] = first * np.sign(scale[:n])
        if origins is not None:
            width = min(origins.shape[1], 3)
            origin[:width] = origins[0, :width] * scale[:width]
        elif vectors is not None and not self.frames:
            self.notes.append("it has no space origin; its first voxel is taken to lie at 0")
        if not np.isfinite(origin).all():
            raise self.refuse("space origin", "it must be finite")
        return directions, origin

    def _plain_grid(self, spatial: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return steps and first places along axes without directions, in mm."""
        spacings, lows, highs = (
            self._numbers(field) for field in ("spacings", "axis mins", "axis maxs")
        )
        centers, units = self.entries("centers"), self.entries("units")
        steps, first = np.ones(len(spatial)), np.zeros(len(spatial))
        for k, axis in enumerate(spatial):
            count = self.sizes[axis]
            unit = units[axis].strip().lower() if len(units) > axis else "mm"
            if unit not in MILLIMETRES:
                raise self.refuse("units", "lengths are in mm, cm, m or um")
            # Like Teem and ITK, samples of unknown kind are taken to fill cells.
            cell = not (len(centers) > axis and centers[axis].lower() == "node")
            low, high, step = lows[axis], highs[axis], spacings[axis]
            if not np.isfinite(step):
                step = (high - low) / (count if cell else max(count - 1, 1))
            if np.isfinite(step):
                steps[k] = step * MILLIMETRES[unit]
            elif not self.frames:
                self.notes.append(f"it states no spacing along axis {axis}; 1 mm is taken")
            if np.isfinite(low):
                first[k] = (
                    low + (0.5 * step if cell and np.isfinite(step) else 0.0)
                ) * MILLIMETRES[unit]
            elif np.isfinite(high) and np.isfinite(step):
                first[k] = (high - step * (count - (0.5 if cell else 1))) * MILLIMETRES[unit]
        if np.isnan(lows[spatial]).all() and not self.frames and "space origin" not in self.header:
            self.notes.append("it states no position; its first voxel is taken to lie at 0")
        if (steps < 0).any():
            raise self.refuse("axis maxs", "they are above the axis mins")
        return steps, first

    def _numbers(self, field: str) -> NDArray[np.float64]:
        """Return the numbers of a field with one for each axis; NaN where there is none."""
        words = self.entries(field) or ["nan"] * len(self.sizes)
        if len(words) != len(self.sizes):
            raise self.refuse(field, f"{len(self.sizes)} axes have as many numbers")
        return np.array([np.nan if word in ("none", "???") else float(word) for word in words])

    def _data(self, size: int) -> DataSections:
        encoding = self.header.get("encoding", "").lower()
        if encoding not in ("raw", "gzip", "gz"):
            raise ConfigurationError(
                f"{self.path}: encoding: {encoding!r} is not supported; use raw or gzip"
            )
        compressed = encoding.startswith("gz")
        lines, skip = (int(self.header.get(each, "0")) for each in ("line skip", "byte skip"))
        if lines < 0 or skip < -1 or (skip == -1 and compressed):
            raise self.refuse(
                "line skip" if lines < 0 else "byte skip", "-1 is for raw data, else from 0"
            )

        def first(file: Path, each: int) -> int:
            if skip == -1:  # the voxels are the last bytes
                return max(file.stat().st_size - each, 0)
            start = _after_lines(file, self.offset if file == self.path else 0, lines)
            return start if compressed else start + skip

        files, inside = self._data_files(), skip if compressed else 0
        return open_data(
            self.path, "data file", files, size, first, compressed=compressed, skip=inside
        )

    def _data_files(self) -> list[Path]:
        name = self.header.get("data file")
        if name is None:
            return [self.path]
        files, words = data_files(self.path, "data file", name, self.names), name.split()
        if words[0] == "LIST" and not files:
            raise self.refuse("data file", "the names of the files follow in the next lines")
        if words[0] == "LIST" or len(files) > 1:
            axes = words[1:] if words[0] == "LIST" else words[4:]
            self._check_pieces(int(axes[0]) if axes else None, len(files))
        return files

    def _check_pieces(self, dimension: int | None, count: int) -> None:
        """Refuse files that are not slices along the last axes."""
        dimension = len(self.sizes) - 1 if dimension is None else dimension
        if not 1 <= dimension <= len(self.sizes):
            raise self.refuse("data file", "the number of axes of each file is out of range")
        wanted = int(np.prod(self.sizes[dimension:], dtype=int))
        if dimension < len(self.sizes) and count != wanted:
            raise self.refuse("data file", f"{wanted} files are needed, {count} are named")

    def _times(self, listed: int, count: int) -> NDArray[np.float64] | None:
        """Return the volumes' times in s; None if the file does not state them."""
        values = self.header.get(f"axis {listed} index values")
        label, unit = (
            (self.entries(field) + [""] * len(self.sizes))[listed].lower()
            for field in ("labels", "units")
        )
        unit = self.header.get(f"axis {listed} index units", unit).lower()
        scale = SECONDS.get(unit)
        if values is not None and label == "time" and unit and not scale:
            raise self.refuse(f"axis {listed} index units", "use s, ms or us")
        if values is not None and (scale or label == "time"):
            times = np.array(values.split(), float) * (scale or 1.0)
            if len(times) != count:
                raise ConfigurationError(
                    f"{self.path}: {len(times)} index values for {count} volumes"
                )
            return times
        if values is not None:
            self.notes.append(
                "its index values have no unit of time, so they are not its times; "
                f"'axis {listed} index units:=s' says that they are"
            )
        return self._regular_times(listed, count)

    def _regular_times(self, listed: int, count: int) -> NDArray[np.float64] | None:
        """Return times from a step along a fourth axis in space, or from its spacing."""
        vectors, origins = self._vectors("space directions"), self._vectors("space origin")
        step = first = np.nan
        units = self.entries("space units")
        scale = SECONDS.get((units + [""] * 4)[3].lower())
        if vectors is not None and vectors.shape[1] == 4:
            step = float(vectors[listed, 3])
            first = float(origins[0, 3]) if origins is not None and origins.shape[1] == 4 else 0.0
        elif vectors is None:
            step, first = (float(self._numbers(each)[listed]) for each in ("spacings", "axis mins"))
            units = self.entries("units")
            scale = SECONDS.get((units + [""] * len(self.sizes))[listed].lower())
        if not (np.isfinite(step) and step > 0) or (scale is None and step == 1.0):
            return None
        step *= scale or 1.0
        if step > MAX_STEP:
            return None
        self.notes.append(f"its volumes are {step:g} s apart, by the spacing along its list axis")
        begin = 0.0 if np.isnan(first) else first * (scale or 1.0)
        return np.asarray(begin + step * np.arange(count), np.float64)


def _after_lines(path: Path, offset: int, lines: int) -> int:
    """Return the offset of the first byte after a number of lines."""
    if lines == 0:
        return offset
    with path.open("rb") as file:
        file.seek(offset)
        for _ in range(lines):
            if not file.readline(MAX_HEADER):
                raise ConfigurationError(f"{path}: line skip: it has fewer than {lines} lines")
        return file.tell()


def _turned_round(data: DataSections, voxels: int, count: int, itemsize: int) -> DataSections:
    """Copy data whose list axis varies fastest to a temporary file in which it varies slowest."""
    file = tempfile.NamedTemporaryFile(prefix="sonoservo-")  # noqa: SIM115
    size = voxels * itemsize
    file.truncate(count * size)
    turned = DataSections([DataSection(Path(file.name), 0, count * size)], count * size)
    weakref.finalize(turned, file.close)
    step = max(1, _BLOCK // (count * itemsize))
    for first in range(0, voxels, step):
        number = min(step, voxels - first)
        block = np.frombuffer(
            data.read(first * count * itemsize, number * count * itemsize), f"V{itemsize}"
        )
        for k, column in enumerate(block.reshape(number, count).T):
            file.seek(k * size + first * itemsize)
            file.write(column.tobytes())
    file.flush()
    return turned
