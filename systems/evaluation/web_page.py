"""Self-contained web pages."""

import base64
import html
import math
from collections.abc import Mapping
from typing import Any

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
{body}
{figures}
</body>
</html>
"""


def web_page(title: str, facts: str, body: str, figures: Mapping[str, bytes]) -> str:
    """Return a self-contained web page.

    Parameters
    ----------
    title
        Title, as plain text.
    facts
        HTML of the line below the title.
    body
        HTML of the part before the figures.
    figures
        Contents of PNG files by caption; captions are plain text.
    """
    return _PAGE.format(
        title=html.escape(title),
        facts=facts,
        body=body,
        figures="\n".join(
            f'<figure><img alt="{html.escape(caption)}" src="data:image/png;base64,'
            f'{base64.b64encode(data).decode()}"><figcaption>{html.escape(caption)}</figcaption>'
            "</figure>"
            for caption, data in figures.items()
        ),
    )


_UNITS = {"mm": "mm", "deg": "°", "n": "N", "s": "s", "ms": "ms"}


def words(key: str) -> str:
    """Return a key as words in HTML: `tip_error_mm` becomes "tip error (mm)"."""
    *words, last = str(key).split("_")
    text = (
        f"{' '.join(words)} ({_UNITS[last]})"
        if words and last in _UNITS
        else " ".join([*words, last])
    )
    return html.escape(text)


def cell_text(value: Any) -> str:
    """Return a value as the HTML of a table cell, with about three digits; a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, float) and math.isinf(value):
        return "∞"
    if isinstance(value, float):
        return f"{value:.{sum(abs(value) < limit for limit in (1, 10, 100))}f}"
    return html.escape(str(value))
