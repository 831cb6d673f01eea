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

    Attributes
    ----------
    newest
        Newest row; None if there is none.
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
