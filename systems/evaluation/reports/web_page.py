"""Self-contained web pages."""

import base64
import html
from collections.abc import Mapping

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
  h2 {{ font-size: 1.2rem; margin: 2rem 0 .4rem; }}
  h3 {{ font-size: 1rem; margin: 1.2rem 0 .2rem; }}
  .verdict {{ border-left: .35rem solid #009e73; background: #f4f6f5; padding: .6rem .9rem; }}
  .verdict.mixed {{ border-color: #e69f00; }}
  .verdict.bad {{ border-color: #d55e00; }}
  .facts {{ color: #666; margin-top: .2rem; }}
  .tables {{ display: flex; flex-wrap: wrap; gap: 0 3rem; }}
  table {{ border-collapse: collapse; margin-bottom: .6rem; }}
  th, td {{ padding: .15rem .9rem .15rem 0; border-bottom: 1px solid #e4e4e4; text-align: right;
           font-variant-numeric: tabular-nums; font-weight: normal; }}
  th {{ color: #666; }}
  th:first-child {{ text-align: left; color: #222; }}
  td {{ overflow-wrap: anywhere; }}
  figure {{ margin: 1.2rem 0 2rem; }}
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
    """Return a self-contained web page."""
    return _PAGE.format(
        title=html.escape(title),
        facts=facts,
        body=body,
        figures="\n".join(picture(*each) for each in figures.items()),
    )


def picture(caption: str, data: bytes) -> str:
    """Return a PNG file's contents, with a caption in plain text, as HTML."""
    text = html.escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
        f"<figcaption>{text}</figcaption></figure>"
    )
