"""Base class of the logs of a run, and the reader and writer of their file `log.npz`."""

import io
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.evaluation.table import Code, Table
from sonoservo.systems.files.memory import require_memory
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.signals.immutable import Immutable

FORMAT = 3  # version of the file format, stored as the array `format`

Array = NDArray[Any]
Row = dict[str, Any]


@dataclass(frozen=True)
class Column:
    """Meaning, unit, extents and type of an array of a log.

    An extent is a number, or a letter that arrays share; a type is "f8", "f4", "u1", "?" or "U".
    """

    what: str
    unit: str
    shape: tuple[int | str, ...]
    dtype: str = "f8"

    def missing(self, shape: Sequence[int]) -> Array:
        """Return an array of a shape without data: NaN, or an empty text."""
        fill: Any = "" if self.dtype == "U" else np.nan if self.dtype[0] == "f" else 0
        return np.full(shape, fill, None if self.dtype == "U" else self.dtype)


def column(what: str, unit: str, shape: str = "", dtype: str = "f8") -> Any:
    """Return a field of a log for an array, with its extents in words: "n 4 4"."""
    extents = tuple(int(each) if each.isdecimal() else each for each in shape.split())
    return field(metadata={"column": Column(what, unit, extents, dtype)})


@dataclass(frozen=True, eq=False, kw_only=True)
class Log(Immutable):
    """Log of a run: arrays with a `Column` each; missing values are NaN or an empty text.

    A field that is a mapping of arrays is written as one array for each key, ``<field>_<key>``.
    """

    def __post_init__(self) -> None:
        extents: dict[int | str, int] = {}
        for name, column in columns(type(self)).items():
            array = np.asarray(getattr(self, name))
            if column.dtype != "U":
                array = array.astype(column.dtype, copy=False)
            array = array.view()
            wanted = column.shape
            fits = array.ndim == len(wanted) and all(
                got == (want if isinstance(want, int) else extents.setdefault(want, got))
                for got, want in zip(array.shape, wanted, strict=True)
            )
            if not fits:
                raise ValueError(f"{name} has shape {array.shape}; it must be {_text(wanted)}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)


LogT = TypeVar("LogT", bound=Log)


def columns(log_class: type[Log]) -> Mapping[str, Column]:
    """Return the column of each array of a log, by the array's name."""
    return {
        each.name: each.metadata["column"]
        for each in fields(log_class)
        if "column" in each.metadata
    }


def _groups(log_class: type[Log]) -> list[str]:
    """Return the names of the fields that are mappings of arrays."""
    return [each.name for each in fields(log_class) if "column" not in each.metadata]


def stack_rows(
    column: Column, name: str, rows: Sequence[Row], extents: Mapping[str, int] | None = None
) -> Array:
    """Return the array of a column from rows that may lack it."""
    if column.dtype == "U":
        return np.array([row.get(name, "") for row in rows], dtype=str)
    shape = [each if isinstance(each, int) else (extents or {})[each] for each in column.shape[1:]]
    missing = column.missing(shape)
    return np.array([row.get(name, missing) for row in rows], column.dtype).reshape(-1, *shape)


def column_table(log_class: type[Log]) -> str:
    """Return the arrays of a log's file as a Markdown table: name, shape, unit, meaning."""
    rows = [
        [Code(name), _text(column.shape), column.unit, column.what]
        for name, column in columns(log_class).items()
    ]
    return Table(["array", "shape", "unit", "meaning"], rows).markdown()


def _text(shape: tuple[int | str, ...]) -> str:
    return "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"


def write_log(path: str | Path, log: Log) -> Path:
    """Write a log to one `.npz` file, atomically."""
    return write_atomically(path, encode_log(log))


def encode_log(log: Log) -> bytes:
    """Return the contents of a log's `.npz` file."""
    arrays = {name: getattr(log, name) for name in columns(type(log))}
    for group in _groups(type(log)):
        arrays |= {f"{group}_{key}": array for key, array in getattr(log, group).items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, format=np.array(FORMAT), **arrays)
    return buffer.getvalue()


def read_log(path: str | Path, log_class: type[LogT]) -> LogT:
    """Read a log of a class from its `.npz` file.

    ValueError if the file is not a complete log of this class, or has another format version.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such log")
    with refusing_failures(path, "not a log, or incomplete"):
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        require_memory(size, str(path), "its arrays")
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        version = arrays.pop("format", None)
        if version is None or version.shape or int(version) != FORMAT:
            raise ConfigurationError(
                f"{path} has format {version}; this program reads format {FORMAT}"
            )
        known = columns(log_class)
        if missing := sorted(known.keys() - arrays.keys()):
            raise ConfigurationError(f"{path} lacks the arrays {', '.join(missing)}")
        given: dict[str, Any] = {name: arrays[name] for name in known}
        for group in _groups(log_class):
            prefix = f"{group}_"
            names = [name for name in arrays if name.startswith(prefix)]
            given[group] = {name.removeprefix(prefix): arrays[name] for name in names}
        return log_class(**given)


_LOOSE = 256  # number of rows that are kept as they came before they are packed


class LogRows:
    """Rows of a log that can grow for hours: all but the newest are packed into arrays.

    `columns` by name and `extents` by letter as for `stack_rows`. A row as it comes takes about 5
    KB; packed, it takes what its numbers need. Of equal texts one is kept.
    """

    newest: Row | None

    def __init__(self, columns: Mapping[str, Column], extents: Mapping[str, int]) -> None:
        self._columns, self._extents = columns, extents
        self.clear()

    def append(self, row: Row) -> None:
        """Add a row."""
        if len(self._loose) == _LOOSE:
            self._pack()
        self._loose.append(row)
        self.newest = row

    def arrays(self) -> dict[str, Array]:
        """Return the array of each column, with one entry for each row."""
        self._pack()
        arrays = {}
        for name, column in self._columns.items():
            # The next arrays begin with these, so that numbers are kept only once.
            self._packed[name] = [np.concatenate(self._packed[name])]
            (array,) = self._packed[name]
            arrays[name] = array.astype(str) if column.dtype == "U" else array.view()
        return arrays

    def clear(self) -> None:
        """Remove all rows."""
        self._packed: dict[str, list[Array]] = {name: [] for name in self._columns}
        self._loose: list[Row] = []
        self.newest = None

    def _pack(self) -> None:
        """Pack the loose rows into arrays; texts into arrays of references."""
        for name, column in self._columns.items():
            if column.dtype == "U":
                texts = [sys.intern(str(row.get(name, ""))) for row in self._loose]
                self._packed[name].append(np.array(texts, dtype=object))
            else:
                self._packed[name].append(stack_rows(column, name, self._loose, self._extents))
        self._loose.clear()
