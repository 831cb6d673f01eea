"""Rows of a log during a run, kept in little memory."""

import sys
from collections.abc import Mapping

import numpy as np

from sonoservo.systems.evaluation.log import Array, Column, Row, stack_rows

_LOOSE = 256
"""Number of rows that are kept as they came before they are packed."""


class LogRows:
    """Rows of a log that can grow for hours: all but the newest are packed into arrays.

    A row as it comes takes about 5 KB, because each of its values is an object; packed, it takes
    what its numbers need. Of equal texts one is kept.

    Parameters
    ----------
    columns
        Column of each value that a row may have, by its name.
    extents
        Extents of the columns' other axes, by their letter; see `stack_rows`.
    """

    def __init__(self, columns: Mapping[str, Column], extents: Mapping[str, int]) -> None:
        self._columns, self._extents = columns, extents
        self.clear()

    @property
    def newest(self) -> Row | None:
        """Newest row; None if there is none."""
        return self._loose[-1] if self._loose else None

    def append(self, row: Row) -> None:
        """Add a row."""
        if len(self._loose) == _LOOSE:
            for name, column in self._columns.items():
                self._packed[name].append(self._pack(column, name))
            self._loose.clear()
        self._loose.append(row)

    def arrays(self) -> dict[str, Array]:
        """Return the array of each column, with one entry for each row."""
        arrays = {}
        for name, column in self._columns.items():
            parts = [*self._packed[name], self._pack(column, name)]
            dtype = str if column.dtype == "U" else column.dtype
            arrays[name] = np.concatenate(parts).astype(dtype, copy=False)
        return arrays

    def clear(self) -> None:
        """Remove all rows."""
        self._packed: dict[str, list[Array]] = {name: [] for name in self._columns}
        self._loose: list[Row] = []

    def _pack(self, column: Column, name: str) -> Array:
        """Return the array of a column of the loose rows; of texts, as references."""
        if column.dtype == "U":
            return np.array([sys.intern(row.get(name, "")) for row in self._loose], dtype=object)
        return stack_rows(column, name, self._loose, self._extents)
