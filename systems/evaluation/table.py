"""Table of results that prints itself as HTML, as Markdown and for a terminal."""

import html
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table as TerminalTable


class Strong(str):
    """Text of a cell that stands out."""


class Code(str):
    """Text of a cell that is a name in a program or a file."""


Cell = Any  # text, `Strong` or `Code`, a number or a boolean, or None if there is nothing to tell


def cell_text(value: Cell, missing: str = "–") -> str:
    """Return a cell as plain text: a number with about three digits, a dash for nothing."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return missing
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if isinstance(value, float):
        return f"{value:.{sum(abs(value) < limit for limit in (1, 10, 100))}f}" if value else "0"
    return str(value)


class Table:
    """Rows of cells, each beginning with its label, under heads (all empty for none)."""

    def __init__(
        self, heads: Sequence[str], rows: Sequence[Sequence[Cell]], missing: str = ""
    ) -> None:
        self.heads, self.rows, self._missing = list(heads), [list(row) for row in rows], missing

    def without_empty_columns(self) -> "Table":
        """Return the table without the columns in which nothing stands."""
        empty = (
            head
            for n, head in enumerate(self.heads)
            if n and not any(cell_text(row[n], "") for row in self.rows)
        )
        return self.without(list(empty))

    def without(self, heads: Sequence[str]) -> "Table":
        """Return the table without the columns of some heads."""
        shown = [n for n, head in enumerate(self.heads) if head not in heads]
        rows = [[row[n] for n in shown] for row in self.rows]
        return Table([self.heads[n] for n in shown], rows, self._missing)

    def grouped(self) -> "Table":
        """Return the table with its first column's texts as lines above their rows."""
        rows = []
        for group, *row in self.rows:
            if group:
                rows.append([Strong(group), *[""] * (len(row) - 1)])
            rows.append(row)
        return Table(["", *self.heads[2:]], rows, self._missing)

    def transposed(self) -> "Table":
        """Return the table with its columns as rows."""
        columns = [*zip(*self.rows, strict=True)] or [()] * len(self.heads)
        rows = [[head, *cells] for head, cells in zip(self.heads[1:], columns[1:], strict=True)]
        return Table([self.heads[0], *columns[0]], rows, self._missing)

    def html(self) -> str:
        """Return the table as HTML."""
        head = "".join(f"<th>{html.escape(each)}</th>" for each in self.heads)
        lines = [f"<tr>{head}</tr>"] if any(self.heads) else []
        for label, *cells in self.rows:
            text = "".join(f"<td>{self._html(each)}</td>" for each in cells)
            lines.append(f"<tr><th>{self._html(label)}</th>{text}</tr>")
        return "<table>" + "\n".join(lines) + "</table>"

    def markdown(self) -> str:
        """Return the table as Markdown; bars in cells are escaped."""
        body = [[self._markdown(each) for each in row] for row in self.rows]
        head, *lines = (f"| {' | '.join(cells)} |" for cells in (self.heads, *body))
        return "\n".join([head, "|" + "---|" * len(self.heads), *lines])

    def terminal(
        self, title: str = "", caption: str = "", widest: int | None = 10
    ) -> "TerminalTable":
        """Return the table for a terminal, with columns no wider than some characters; see rich."""
        from rich import box
        from rich.table import Table as TerminalTable
        from rich.text import Text

        table = TerminalTable(
            title=title, caption=caption, box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False
        )
        table.add_column(self.heads[0])
        for head in self.heads[1:]:
            table.add_column(head, justify="right", max_width=widest)
        for row in self.rows:
            texts = [(cell_text(each, self._missing), isinstance(each, Strong)) for each in row]
            table.add_row(*(Text(text, style="bold" if strong else "") for text, strong in texts))
        return table

    def _html(self, cell: Cell) -> str:
        text = html.escape(cell_text(cell, self._missing))
        tag = "b" if isinstance(cell, Strong) else "code" if isinstance(cell, Code) else ""
        return f"<{tag}>{text}</{tag}>" if tag and text else text

    def _markdown(self, cell: Cell) -> str:
        text = cell_text(cell, self._missing).replace("|", r"\|")
        mark = "**" if isinstance(cell, Strong) else "`" if isinstance(cell, Code) else ""
        return f"{mark}{text}{mark}" if text else text
