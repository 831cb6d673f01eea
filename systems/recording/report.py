"""A run on one web page."""

import base64
import html
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sonoservo.systems.recording.files import write_atomically

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
  :root {{ color-scheme: light; }}
  body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto;
         padding: 0 1rem; color: #222; background: #fff; }}
  h1 {{ font-size: 1.6rem; margin-bottom: 0; }}
  h2 {{ font-size: 1.1rem; margin: 2rem 0 .4rem; }}
  .facts {{ color: #666; margin-top: .2rem; }}
  .tables {{ display: flex; flex-wrap: wrap; gap: 0 3rem; }}
  table {{ border-collapse: collapse; margin-bottom: .6rem; }}
  th, td {{ padding: .15rem .9rem .15rem 0; border-bottom: 1px solid #e4e4e4; text-align: right;
           font-variant-numeric: tabular-nums; font-weight: normal; }}
  th {{ color: #666; }}
  th:first-child {{ text-align: left; color: #222; }}
  td small {{ color: #0072b2; margin-left: .3rem; }}
  figure {{ margin: 2rem 0; }}
  figcaption {{ color: #666; }}
  img {{ max-width: 100%; height: auto; }}
  code {{ background: #f3f3f3; padding: .1rem .3rem; }}
</style>
</head>
<body>
<h1>{title}</h1>
<p class="facts">{facts}</p>
{lead}
<div class="tables">
{tables}
</div>
{figures}
</body>
</html>
"""


def report_page(
    summary: Mapping[str, Any],
    figures: Mapping[str, bytes],
    *,
    command: str = "",
    paper: Mapping[str, float] | None = None,
    replay: str = "",
) -> str:
    """Return a run as one HTML page that needs no other file.

    Parameters
    ----------
    summary
        What `summary.json` holds: single values head the page, `scenario` names it, and each block
        makes a table.
    figures
        PNG files by caption.
    command
        That repeats the run.
    paper
        Published figures to set beside ours, by the path of ours: ``{"servo.at_rest.x_mm": 1.1}``.
    replay
        Relative address of the replay.
    """
    single = {key: value for key, value in summary.items() if not isinstance(value, Mapping)}
    title = str(single.pop("scenario", "Run"))
    facts = " · ".join(f"{_words(key)} {_value(value)}" for key, value in single.items())
    lead = ""
    if command:
        lead += f"<p><code>{html.escape(command)}</code></p>\n"
    if replay:
        lead += f'<p><a href="{html.escape(replay)}">Watch the replay</a></p>\n'
    if paper:
        lead += "<p>Published figures are set beside ours in <small>(brackets)</small>.</p>\n"
    return _PAGE.format(
        title=html.escape(title),
        facts=facts,
        lead=lead,
        tables="\n".join(
            _block(key, value, paper or {})
            for key, value in summary.items()
            if isinstance(value, Mapping) and value
        ),
        figures="\n".join(
            f'<figure><img alt="{html.escape(caption)}" src="data:image/png;base64,'
            f'{base64.b64encode(data).decode()}"><figcaption>{html.escape(caption)}</figcaption></figure>'
            for caption, data in figures.items()
        ),
    )


def write_report(
    path: str | Path, summary: Mapping[str, Any], figures: Mapping[str, bytes], **details: Any
) -> Path:
    """Write `report_page` to a file, atomically."""
    return write_atomically(path, report_page(summary, figures, **details))


def _block(name: str, block: Mapping[str, Any], paper: Mapping[str, float]) -> str:
    """Return a block's tables: one of its single values, one for each set of equal columns."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for key, value in block.items():
        columns = tuple(value) if isinstance(value, Mapping) else ()
        groups.setdefault(columns, []).append(key)
    tables = []
    for columns, keys in groups.items():
        head = "".join(f"<th>{_words(column)}</th>" for column in columns)
        rows = [f"<tr><th></th>{head}</tr>"] if columns else []
        for key in keys:
            paths = [f"{name}.{key}.{column}" for column in columns] or [f"{name}.{key}"]
            values = [block[key][column] for column in columns] or [block[key]]
            cells = "".join(
                f"<td>{_value(value)}{_published(paper.get(path))}</td>"
                for path, value in zip(paths, values, strict=True)
            )
            rows.append(f"<tr><th>{_words(key)}</th>{cells}</tr>")
        tables.append("<table>" + "\n".join(rows) + "</table>")
    return f"<section><h2>{_words(name).capitalize()}</h2>\n" + "\n".join(tables) + "</section>"


_UNITS = {"mm": "mm", "deg": "°", "n": "N", "s": "s", "ms": "ms"}


def _words(key: str) -> str:
    """`tip_error_mm` -> tip error (mm)."""
    *words, last = str(key).split("_")
    text = (
        f"{' '.join(words)} ({_UNITS[last]})"
        if words and last in _UNITS
        else " ".join([*words, last])
    )
    return html.escape(text)


def _value(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.{sum(abs(value) < limit for limit in (1, 10, 100))}f}"
    return html.escape(str(value))


def _published(value: float | None) -> str:
    return "" if value is None else f"<small>({_value(float(value))})</small>"
