"""Writes a sequence of arrays to one NRRD file while they come."""

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.writing import write_atomically

SUFFIX = ".seq.nrrd"
"""By which 3D Slicer knows a sequence."""

_TYPE_NAMES = {"uint8": "uint8", "float32": "float"}


class SequenceWriter:
    """Writes a ``.seq.nrrd``, its list axis last, as 3D Slicer does now.

    The format's header comes before the data and holds their number. So while arrays come, data and
    header are two files, ``NAME.partial.raw`` and ``NAME.partial.seq.nhdr``, of which the header is
    replaced after every array: whatever interrupts the program, what was written is a valid
    sequence. `close` joins them, and only then the file has its final name.

    Parameters
    ----------
    path
        Where to; the name ends in ``.seq.nrrd``.
    header
        Lines of the header that describe the arrays' own axes, by field. For every field with an
        entry for each axis, the entry of the list axis is added here.
    """

    def __init__(self, path: Path, header: Mapping[str, str]) -> None:
        if path.is_dir():
            raise IsADirectoryError(f"{path}: it is a folder; a recording cannot be written there")
        self.path = path
        self.partial_header = partial_path(path, SUFFIX.replace("nrrd", "nhdr"))
        self._partial_data = partial_path(path, ".raw")
        self._header = header
        self._times: list[str] = []
        self._frames: list[str] = []
        self._shape: tuple[int, ...] = ()
        self._dtype = np.dtype(np.uint8)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.partial_header.unlink(missing_ok=True)
        self._data = self._partial_data.open("wb")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._times)

    def append(self, array: NDArray[Any], time: float, fields: Mapping[str, str]) -> None:
        """Write an array.

        Parameters
        ----------
        array
            uint8 or float32; all must have one shape and type.
        time
            In s; it becomes the array's index value.
        fields
            What else is known about it; kept as PLUS does, ``Seq_Frame0012_Name``.
        """
        if not self._times:
            self._shape, self._dtype = array.shape, array.dtype
        if (array.shape, array.dtype) != (self._shape, self._dtype):
            raise ValueError(f"{self.path}: an array differs from the first in shape or type")
        number = len(self._times)
        self._data.write(array.tobytes(order="F"))
        self._data.flush()
        self._times.append(repr(float(time)))
        for name, value in fields.items():
            self._frames.append(f"Seq_Frame{number:04d}_{name}:={value}\n")
        write_atomically(self.partial_header, self._text(self._partial_data.name))

    def close(self) -> None:
        """Give the file its final name; without any array nothing is left."""
        if self._data.closed:
            return
        self._data.close()
        if self._times:
            self._join()
        for partial in (self._partial_data, self.partial_header):
            partial.unlink(missing_ok=True)

    def _join(self) -> None:
        handle, joined = tempfile.mkstemp(dir=self.path.parent, prefix=f".{self.path.name}.")
        try:
            with os.fdopen(handle, "wb") as file, self._partial_data.open("rb") as data:
                file.write(self._text("").encode())
                shutil.copyfileobj(data, file, 1 << 24)
            os.chmod(joined, 0o644)  # mkstemp's files are for their owner alone
            os.replace(joined, self.path)
        except BaseException:
            os.unlink(joined)
            raise

    def _text(self, data_file: str) -> str:
        """Return the header; with the name of the data's file if they are not attached."""
        sizes = " ".join(str(n) for n in (*self._shape, len(self._times)))
        axis = len(self._shape)
        empty = '"" ' * axis
        lines = [
            "NRRD0005",
            "# Written by sonoservo",
            f"type: {_TYPE_NAMES[self._dtype.name]}",
            f"dimension: {axis + 1}",
            f"sizes: {sizes}",
            *(f"{name}: {value}" for name, value in self._header.items()),
            f'labels: {empty}"time"',
            f'units: {empty}"s"',
            "endian: little",
            "encoding: raw",
            *([f"data file: {data_file}"] if data_file else []),
            "DataNodeClassName:=vtkMRMLScalarVolumeNode",
            f"axis {axis} index type:=numeric",
            f"axis {axis} index values:={' '.join(self._times)}",
        ]
        return "\n".join(lines) + "\n" + "".join(self._frames) + "\n"


def partial_path(path: Path, suffix: str) -> Path:
    """Return where a part of a recording is while it is being made."""
    return path.with_name(path.name.removesuffix(SUFFIX) + ".partial" + suffix)
