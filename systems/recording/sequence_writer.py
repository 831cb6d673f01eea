"""Writer of a sequence of arrays to one NRRD file, array by array."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.files.writing import Closing, claim, naming, replacing, write_atomically

SUFFIX = ".seq.nrrd"
"""Suffix by which 3D Slicer recognises a sequence."""

_TYPE_NAMES = {"uint8": "uint8", "float32": "float"}


class SequenceWriter(Closing):
    """Writes a ``.seq.nrrd`` file with the list axis last, as 3D Slicer does.

    Fields of the header with one entry per axis include that of the list axis, except ``sizes``,
    ``labels`` and ``units``, which are added here.
    """

    # The format's header precedes the data and holds the number of arrays. Until `close` joins them
    # under the final name, data and header are therefore separate files, ``NAME.partial.raw`` and
    # ``NAME.partial.seq.nhdr``. The header is replaced after every array, so that they are a valid
    # sequence even after an interruption.

    def __init__(self, path: Path, header: Mapping[str, str]) -> None:
        if path.is_dir():
            raise IsADirectoryError(f"{path}: it is a folder; give the path of a file")
        self.path = path
        self.partial_header = partial_path(path, SUFFIX.replace("nrrd", "nhdr"))
        self._partial_data = partial_path(path, ".raw")
        self._header = header
        self._times: list[str] = []
        self._frames: list[str] = []
        self._shape: tuple[int, ...] = ()
        self._dtype = np.dtype(np.uint8)
        with naming(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._data = self._partial_data.open("ab")
        claim(self._data.fileno(), path, "another file")
        self._data.truncate(0)
        self.partial_header.unlink(missing_ok=True)

    def __len__(self) -> int:
        return len(self._times)

    def append(self, array: NDArray[Any], time: float, fields: Mapping[str, str]) -> None:
        """Write an array, like the first one, at a time in s, with fields as of PLUS."""
        if not self._times:
            self._shape, self._dtype = array.shape, array.dtype
        if (array.shape, array.dtype) != (self._shape, self._dtype):
            raise ValueError(f"{self.path}: an array differs from the first in shape or type")
        number = len(self._times)
        with naming(self._partial_data):
            self._data.write(array.tobytes(order="F"))
            self._data.flush()
        self._times.append(repr(float(time)))
        for name, value in fields.items():
            self._frames.append(f"Seq_Frame{number:04d}_{name}:={value}\n")
        write_atomically(self.partial_header, self._text(self._partial_data.name))

    def close(self) -> None:
        """Give the file its final name; without any array, no file is left."""
        if self._data.closed:
            return
        self._data.close()
        if self._times:
            self._join()
        for partial in (self._partial_data, self.partial_header):
            partial.unlink(missing_ok=True)

    def _join(self) -> None:
        with (
            naming(self.path),
            replacing(self.path) as file,
            self._partial_data.open("rb") as data,
        ):
            file.write(self._text("").encode())
            shutil.copyfileobj(data, file, 1 << 24)

    def _text(self, data_file: str) -> str:
        """Return the header, with the name of the data file if the data are detached."""
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
    """Return the path of a part of a recording while it is being written."""
    return path.with_name(path.name.removesuffix(SUFFIX) + ".partial" + suffix)
