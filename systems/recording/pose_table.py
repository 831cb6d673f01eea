"""Tables of poses (CSV) beside images of formats that hold none, such as PNG and DICOM."""

import csv
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Mapping, Sequence
from pathlib import Path, PureWindowsPath

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.volume_file import number_or_nan
from sonoservo.systems.recording.transform_chain import ends_of
from sonoservo.systems.recording.valid_frames import matrix_text, read_matrix

_MOST_BYTES = 1 << 26
_ELEMENT = re.compile(r"(?:(\w+To\w+?)_)?m?([0-3])([0-3])", re.IGNORECASE)
_VECTOR = re.compile(r"(?:(\w+To\w+?)_)?(x|y|z|qw|qx|qy|qz)", re.IGNORECASE)
_PARTS = ("x", "y", "z", "qw", "qx", "qy", "qz")
_ELEMENTS = [f"m{row}{column}" for row in range(3) for column in range(4)]
_DEFAULT = "ProbeToReference"
_TIMES = {
    "t": 1.0,
    "time": 1.0,
    "timestamp": 1.0,
    "time_s": 1.0,
    "time_ms": 1e-3,
    "timestamp_ms": 1e-3,
}
_NAMES = ("file", "filename", "image", "img", "name")
_ROUNDED = 1e-2  # Largest difference from 1 of the length of a unit quaternion that is rounded


def read_pose_table(path: Path, files: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """Read a table with a row for each frame's file, as fields that PLUS would write, and notes.

    The first row names the columns, which commas, semicolons or tabs separate. ``file`` or
    ``frame`` (from 0) tells which frame a row belongs to; without either, rows are in order. A
    file's name may have a folder before it, other capitals or no suffix. ``time`` is in s,
    ``time_ms`` in ms. A pose is ``x, y, z`` in mm with the unit quaternion ``qw, qx, qy, qz``, or
    the elements ``m00`` to ``m23`` of a matrix in mm. It is that of the probe in the reference
    (``ProbeToReference``), unless the columns begin with another name, such as
    ``ImageToReference_m00``. A frame whose row cannot be read is left out.
    """
    if not path.is_file():
        raise ConfigurationError(f"{path}: there is no such table of poses")
    if path.stat().st_size > _MOST_BYTES:
        raise ConfigurationError(f"{path}: it is too large for a table of poses")
    with refusing_failures(path, "it is no table of poses"):
        data = path.read_bytes()
        encoding = "utf-16" if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)) else "utf-8-sig"
        text = data.decode(encoding, errors="replace")
        lines = text.splitlines()
        separator = next((each for each in ",;\t" if lines and each in lines[0]), ",")
        rows = list(csv.DictReader(lines, delimiter=separator))
        if not rows:
            raise ConfigurationError(f"{path}: it has no rows below that of the names")
        names = [str(each).strip() for each in rows[0] if each]
        if not any(_ELEMENT.fullmatch(each) or _VECTOR.fullmatch(each) for each in names):
            raise ConfigurationError(
                f"{path}: none of its columns ({', '.join(names)[:100]}) is part of a pose: x, y, "
                "z, qw, qx, qy and qz, or m00 to m23"
            )
        fields: dict[str, str] = {}
        posed, unread = dict[int, int](), ""
        numbers = {Path(name).stem.casefold(): number for number, name in enumerate(files)}
        numbers |= {name.casefold(): number for number, name in enumerate(files)}
        for place, raw in enumerate(rows):
            row = {_plain(str(key)): str(value).strip() for key, value in raw.items() if key}
            number = _number(path, row, place, numbers)
            if number is None:
                unread = unread or f"row {place + 1}: {_unknown(row, files)}"
                continue
            if number >= len(files):
                raise ConfigurationError(
                    f"{path}: row {place + 1} is that of frame {number}; there are {len(files)}, "
                    "counted from 0"
                )
            if number in posed:
                raise ConfigurationError(
                    f"{path}: rows {posed[number] + 1} and {place + 1} are both that of "
                    f"{files[number]}"
                )
            posed[number] = place
            frame = f"Seq_Frame{number:04d}"
            for name, scale in _TIMES.items():
                if name in row:
                    fields[f"{frame}_Timestamp"] = repr(scale * number_or_nan(row[name]))
            matrices = _matrices(path, row, f"row {place + 1}")
            for name, text in matrices.items():
                fields[f"{frame}_{name}Transform"] = text
            if not matrices and not unread:
                unread = f"row {place + 1}: {_unread(row)}"
        if not any(name.endswith("Transform") for name in fields):
            raise ConfigurationError(f"{path}: none of its rows has a pose; {unread}")
        notes = [f"{path.name}: not all rows give a pose; {unread}"] if unread else []
        if unused := ", ".join(each for each in names if not _is_read(each)):
            notes.append(f"columns of {path.name} that are neither times nor poses: {unused}")
        return fields, notes


def _is_read(name: str) -> bool:
    return bool(
        _ELEMENT.fullmatch(name)
        or _VECTOR.fullmatch(name)
        or name.lower() in {*_NAMES, *_TIMES, "frame"}
    )


def _unknown(row: Mapping[str, str], files: Sequence[str]) -> str:
    """Return why a row belongs to no frame."""
    for name in _NAMES:
        if name in row:
            return f"column {name}: there is no image {row[name]!r}; the first one is {files[0]!r}"
    return f"column frame: {row['frame']!r} is no number from 0 on"


def _unread(row: Mapping[str, str]) -> str:
    """Return what of a row without a pose is no number."""
    for key, text in row.items():
        part = _ELEMENT.fullmatch(key) or _VECTOR.fullmatch(key)
        if part and not np.isfinite(number_or_nan(text)):
            comma = ", with a comma for a point?" if re.fullmatch(r"-?\d+,\d+", text) else ""
            return f"column {key}: {text!r} is no number{comma}"
    return "its quaternion has a length other than 1"


def _plain(key: str) -> str:
    """Return a column's name in small letters, but for that of a transform."""
    return key.strip() if "To" in key else key.strip().lower()


def _number(
    path: Path, row: Mapping[str, str], place: int, numbers: Mapping[str, int]
) -> int | None:
    for name in _NAMES:
        if name in row:
            return numbers.get(PureWindowsPath(row[name]).name.casefold())
    if "frame" not in row:
        return place
    number = number_or_nan(row["frame"])
    return int(number) if number >= 0 and number.is_integer() else None


def _matrices(path: Path, row: Mapping[str, str], where: str) -> dict[str, str]:
    """Return the matrices of a row by name, as text; those with a missing number are left out."""
    found: dict[str, np.ndarray] = {}
    elements: dict[str, set[str]] = {}
    vectors: dict[str, dict[str, float]] = {}
    for key, text in row.items():
        element, vector = _ELEMENT.fullmatch(key), _VECTOR.fullmatch(key)
        match = element or vector
        if match is None:
            continue
        name = match[1] or _DEFAULT
        if ends_of(name) is None:
            raise ConfigurationError(f"{path}: column {key!r}: {name!r} names no transform")
        number = number_or_nan(text)
        if element:
            matrix = found.setdefault(name, np.vstack([np.full((3, 4), np.nan), [0, 0, 0, 1]]))
            matrix[int(element[2]), int(element[3])] = number
            elements.setdefault(name, set()).add(f"m{element[2]}{element[3]}")
        else:
            vectors.setdefault(name, {})[match[2].lower()] = number
    for name, held in elements.items():
        if missing := ", ".join(key for key in _ELEMENTS if key not in held):
            raise ConfigurationError(
                f"{path}: the matrix {name} is m00 to m23, row and column counted from 0; there is "
                f"no column {missing}"
            )
    for name, each in vectors.items():
        if len(each) != 7:
            missing = ", ".join(key for key in _PARTS if key not in each)
            raise ConfigurationError(
                f"{path}: a pose is {', '.join(_PARTS)}, or a matrix; there is no column {missing}"
            )
        q = np.array([each[key] for key in ("qw", "qx", "qy", "qz")])
        place = [each[key] for key in "xyz"]
        if (
            np.isfinite(q).all()
            and np.isfinite(place).all()
            and abs(np.linalg.norm(q) - 1) < _ROUNDED
        ):
            pose = RigidTransform(Quaternion(q / np.linalg.norm(q)), place)
            found[name] = pose.GetAsMatrix4()
    texts = {
        name: matrix_text(matrix) for name, matrix in found.items() if np.isfinite(matrix).all()
    }
    for name, text in texts.items():
        if found[name][3, :3].any():  # the whole table's fault: a lost pose is zero throughout
            read_matrix(path, f"{where}: {name}", text)
    return texts
