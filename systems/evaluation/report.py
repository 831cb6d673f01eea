"""Report and replay of a run as web pages."""

import html
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydrake.geometry import Meshcat

from sonoservo.systems.evaluation.web_page import cell_text, web_page, words
from sonoservo.systems.files.writing import write_atomically


def report_page(
    summary: Mapping[str, Any],
    figures: Mapping[str, bytes],
    *,
    command: str = "",
    paper: Mapping[str, float] | None = None,
    replay: str = "",
) -> str:
    """Return the report of a run as one self-contained HTML page.

    Parameters
    ----------
    summary
        Content of `summary.json`. `scenario` becomes the title, the other single values the line
        below it, and each block a section with its tables.
    figures
        Contents of PNG files by caption.
    command
        Command that repeats the run.
    paper
        Published values to show beside the simulated ones, by the dotted path of the simulated
        value: ``{"servo.at_rest.x_mm": 1.1}``.
    replay
        Relative address of the replay.
    """
    single = {key: value for key, value in summary.items() if not isinstance(value, Mapping)}
    title = str(single.pop("scenario", "Run"))
    facts = " · ".join(f"{words(key)} {cell_text(value)}" for key, value in single.items())
    lead = ""
    if command:
        lead += f"<p><code>{html.escape(command)}</code></p>\n"
    lead += _missing(summary.get("detection"))
    if replay:
        lead += f'<p><a href="{html.escape(replay)}">Watch the replay</a></p>\n'
    if paper:
        lead += "<p>Published values are shown in <small>(brackets)</small>.</p>\n"
    tables = "\n".join(
        _block(key, value, paper or {})
        for key, value in summary.items()
        if isinstance(value, Mapping) and value
    )
    return web_page(title, facts, f'{lead}<div class="tables">\n{tables}\n</div>', figures)


def write_report(
    path: str | Path, summary: Mapping[str, Any], figures: Mapping[str, bytes], **details: Any
) -> Path:
    """Write `report_page` to a file, atomically."""
    return write_atomically(path, report_page(summary, figures, **details))


def save_replay(meshcat: Meshcat, path: str | Path) -> Path:
    """Write a Meshcat's recording as one HTML page that needs no server.

    Call ``meshcat.StartRecording()`` before the simulator is initialised: the recording lacks
    everything shown or hidden earlier. The live page, if one is open, plays the recording too.

    Returns
    -------
    Path of the page.
    """
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return write_atomically(path, meshcat.StaticHtml())


def _missing(detection: object) -> str:
    """Return a paragraph that says why no needle was found; empty if one was."""
    if not isinstance(detection, Mapping) or not detection.get("reason"):
        return ""
    said = " ".join(filter(None, (detection["reason"], detection.get("advice"))))
    return f"<p><strong>No needle was found.</strong> {html.escape(said)}</p>\n"


def _block(name: str, block: Mapping[str, Any], paper: Mapping[str, float]) -> str:
    """Return a block's tables: one of its single values, and one for each set of equal columns."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for key, value in block.items():
        columns = tuple(value) if isinstance(value, Mapping) else ()
        groups.setdefault(columns, []).append(key)
    tables = []
    for columns, keys in groups.items():
        head = "".join(f"<th>{words(column)}</th>" for column in columns)
        rows = [f"<tr><th></th>{head}</tr>"] if columns else []
        for key in keys:
            paths = [f"{name}.{key}.{column}" for column in columns] or [f"{name}.{key}"]
            values = [block[key][column] for column in columns] or [block[key]]
            cells = "".join(
                f"<td>{cell_text(value)}{_published(paper.get(path))}</td>"
                for path, value in zip(paths, values, strict=True)
            )
            rows.append(f"<tr><th>{words(key)}</th>{cells}</tr>")
        tables.append("<table>" + "\n".join(rows) + "</table>")
    return f"<section><h2>{words(name).capitalize()}</h2>\n" + "\n".join(tables) + "</section>"


def _published(value: float | None) -> str:
    return "" if value is None else f"<small>({cell_text(float(value))})</small>"
