"""Report and replay of a run as web pages."""

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from pydrake.geometry import Meshcat

from sonoservo.systems.evaluation.labels import LABELS, MORE_LABELS, look_up, sections
from sonoservo.systems.evaluation.reports.verdict import Verdict, unbroken
from sonoservo.systems.evaluation.table import Code, Table
from sonoservo.systems.files.writing import write_atomically

_MANY = 20  # changes of another tracker, say, are folded


@dataclass(frozen=True, kw_only=True)
class Change:
    """A field of a scenario that differs from what it is compared with; both values as text."""

    path: str
    meaning: str = ""
    before: str
    after: str


@dataclass(frozen=True, kw_only=True)
class Story:
    """Content of a report besides figures and plots."""

    verdict: Verdict | None = None
    scenario: Sequence[str] = ()  # sentences that describe it
    base: str = ""  # what the scenario is compared with
    changes: Sequence[Change] = ()  # fields in which it differs from that
    command: str = ""  # repeats the run
    links: Mapping[str, str] = field(default_factory=dict)  # text by relative address


def report_page(
    summary: Mapping[str, Any],
    figures: Mapping[str, bytes],
    *,
    story: Story | None = None,
    key_frames: Mapping[str, bytes] | None = None,
    labels: Mapping[str, str] = LABELS,
    paper: Mapping[str, float] | None = None,
) -> str:
    """Return the report of a run as one self-contained HTML page.

    `summary` is the content of `summary.json`, and `story` the verdict, the scenario in words and
    links. `figures` and `key_frames` are PNG files of plots, and of pictures from the run, by
    caption. `labels` name the numbers that are shown, and `paper` has published values to stand
    beside them, both by the dotted path into the summary: ``{"servo.at_rest.x_mm": 1.1}``.
    """
    body = report_body(summary, story=story, key_frames=key_frames, labels=labels, paper=paper)
    return web_page(
        str(summary.get("scenario", "Run")),
        html.escape(facts_text(summary)),
        f"{body}\n<h2>Plots</h2>" if figures else body,
        figures,
    )


def report_body(
    summary: Mapping[str, Any],
    *,
    story: Story | None = None,
    key_frames: Mapping[str, bytes] | None = None,
    labels: Mapping[str, str] = LABELS,
    paper: Mapping[str, float] | None = None,
) -> str:
    """Return a report without title, page and plots as HTML; see `report_page`."""
    story = story or Story()
    body = [_verdict_text(story.verdict), _links(story.links), _scenario_text(story)]
    if key_frames:
        body += ["<h2>Key frames</h2>", *(picture(*each) for each in key_frames.items())]
    body.append(_figures_text(summary, labels, paper or {}))
    return "\n".join(filter(None, body))


def write_report(
    path: str | Path, summary: Mapping[str, Any], figures: Mapping[str, bytes], **details: Any
) -> Path:
    """Write `report_page` to a file, atomically."""
    return write_atomically(path, report_page(summary, figures, **details))


def save_replay(meshcat: Meshcat, path: str | Path) -> Path:
    """Write a Meshcat's recording, begun before the simulation, as a page without server."""
    meshcat.StopRecording()
    meshcat.PublishRecording()
    return write_atomically(path, meshcat.StaticHtml())


def facts_text(summary: Mapping[str, Any]) -> str:
    """Return seed, program version and times of a run as one line of text."""
    facts = []
    if "seed" in summary:
        facts.append(f"seed {summary['seed']}")
    if "version" in summary:
        facts.append(f"sonoservo {summary['version']}")
    if (wall := summary.get("wall_s")) is not None:
        if (simulated := summary.get("simulated_s")) is not None:
            speed = speed_text(summary["real_time_factor"])
            facts.append(f"{simulated:.1f} s simulated in {wall:.1f} s ({speed} x real time)")
        else:
            facts.append(f"computed in {wall:.1f} s")
    if (compiled := summary.get("compile_s", 0.0)) > 0.1:
        facts.append(f"compiling kernels took {compiled:.0f} s more, which no figure counts")
    if summary.get("interrupted"):
        facts.append("interrupted")
    return " · ".join(facts)


def speed_text(factor: float) -> str:
    """Return a multiple of real time with one decimal, or with one digit that is not 0."""
    return f"{factor:.1f}" if factor >= 0.05 else f"{factor:.1g}"


def _verdict_text(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    headline, text = (html.escape(unbroken(each)) for each in (verdict.headline, verdict.text))
    return f'<p class="verdict {verdict.grade}"><strong>{headline}.</strong> {text}</p>'


def _links(links: Mapping[str, str]) -> str:
    each = (f'<a href="{html.escape(to)}">{html.escape(text)}</a>' for to, text in links.items())
    return f"<p>{' · '.join(each)}</p>" if links else ""


def _scenario_text(story: Story) -> str:
    parts = []
    if story.scenario:
        parts.append(f"<h2>Scenario</h2>\n<p>{html.escape(' '.join(story.scenario))}</p>")
    if story.changes:
        unfolded = " open" if len(story.changes) < _MANY else ""
        parts.append(
            f"<details{unfolded}><summary>Changed from {html.escape(story.base)} "
            f"({len(story.changes)}):</summary>\n{changes_table(story)}</details>"
        )
    elif story.base:
        parts.append(f"<p>Nothing is changed from {html.escape(story.base)}.</p>")
    if story.command:
        parts.append(f"<p>To repeat it: <code>{html.escape(story.command)}</code></p>")
    return "\n".join(parts)


def changes_table(story: Story) -> str:
    """Return the changed fields of a scenario as an HTML table."""
    rows = [(each.meaning, Code(each.path), each.before, each.after) for each in story.changes]
    return Table(["", "field", "default", "here"], rows).html()


def _figures_text(
    summary: Mapping[str, Any], labels: Mapping[str, str], paper: Mapping[str, float]
) -> str:
    """Return the tables of a run's figures, each with the paper's values if it has any."""
    tables = []
    for heading, shown in sections(told(summary, {**labels, **MORE_LABELS})).items():
        rows = [
            [label, look_up(summary, path), float(paper[path]) if path in paper else ""]
            for path, label in shown.items()
        ]
        compared = any(path in paper for path in shown)
        heads = ["", "this run", "paper"] if compared else ["", ""]
        body = Table(heads, [row[: len(heads)] for row in rows]).html()
        tables.append(f"<section><h3>{html.escape(heading)}</h3>\n{body}</section>")
    if not tables:
        return ""
    return '<h2>Figures</h2>\n<div class="tables">' + "\n".join(tables) + "</div>"


def told(summary: Mapping[str, Any], labels: Mapping[str, str]) -> dict[str, str]:
    """Return the labels of the figures that a summary has; nothing counts from no detection on."""
    never = "detection" in summary and look_up(summary, "detection.volume") is None
    since = [f"tracking.{each}" for each in ("volumes", "tracked", "lost_events") if never]
    return {
        path: label
        for path, label in labels.items()
        if look_up(summary, path) is not None and path not in since
    }


def web_page(title: str, facts: str, body: str, figures: Mapping[str, bytes]) -> str:
    """Return a self-contained web page."""
    page = (files("sonoservo.systems.evaluation.reports") / "page.html").read_text()
    shown = "\n".join(picture(*each) for each in figures.items())
    parts = {"title": html.escape(title), "facts": facts, "body": body, "figures": shown}
    return Template(page).substitute(parts)


def picture(caption: str, data: bytes) -> str:
    """Return a PNG file's contents, with a caption in plain text, as HTML."""
    text = html.escape(caption)
    return (
        f'<figure><img alt="{text}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
        f"<figcaption>{text}</figcaption></figure>"
    )
