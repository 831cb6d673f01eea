"""Results of a study, and their files: JSON, pictures and a web page."""

import html
import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from matplotlib.figure import Figure

from sonoservo.diagrams.studies.fingerprint import made_with
from sonoservo.diagrams.studies.records import present_commit
from sonoservo.diagrams.studies.run_group import Value
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.systems.evaluation.intervals import proportion_interval
from sonoservo.systems.evaluation.reports.plots import png
from sonoservo.systems.evaluation.reports.report import web_page
from sonoservo.systems.evaluation.table import Strong, Table, cell_text
from sonoservo.systems.files.writing import write_atomically, write_json

Side = Literal["at most", "at least"]  # side of a target on which a figure must lie


class Verdict(StrEnum):
    """Verdicts on a target."""

    MET = "yes"
    NOT_MET = "no"
    UNDECIDED = "undecided"  # the interval crosses the target: more runs would tell
    NOT_MEASURED = "not measured"
    """No run gave the figure: it was not requested, or no run got so far."""


def verdict(
    value: float | None, low: float | None, high: float | None, target: float, wanted: Side
) -> Verdict:
    """Return the verdict on a target."""
    if value is None:
        return Verdict.NOT_MEASURED
    if low is not None and high is not None and low < target < high:
        return Verdict.UNDECIDED
    good = value <= target if wanted == "at most" else value >= target
    return Verdict.MET if good else Verdict.NOT_MET


def can_be_judged(total: int, target: float, wanted: Side) -> bool:
    """Return True if a share of runs can meet a target, and can miss it."""
    possible = set()
    for number in range(total + 1 if total else 0):
        low, high = proportion_interval(number, total)
        share = 100 * number / total
        possible.add(verdict(share, 100 * low, 100 * high, target, wanted))
    return {Verdict.MET, Verdict.NOT_MET} <= possible


def summary_of(verdicts: Collection[Verdict]) -> str:
    """Return how many of the measured targets are met, and what is open, as text."""
    if not verdicts:
        return "no targets"
    counts = Counter(verdicts)
    measured = len(verdicts) - counts[Verdict.NOT_MEASURED]
    said = [f"{counts[Verdict.MET]} of {measured} targets met"]
    open_ones = (Verdict.UNDECIDED, Verdict.NOT_MEASURED)
    return ", ".join([*said, *(f"{counts[each]} {each}" for each in open_ones if counts[each])])


@dataclass(frozen=True, kw_only=True)
class StudyRow:
    """One quantity of a study: the paper's figure, ours, the published method's, and the target.

    Figures are `estimated`, as a real experiment could report them, or `true`, from ground truth.
    An interval is that of the true figure, or of the estimated one without it; infinite ends tell
    that there were too few runs, None that none was computed. The target is one for the same
    figure.
    """

    experiment: str
    quantity: str  # with its conditions
    unit: str = ""
    paper: float | None = None  # figure of the publication
    estimated: float | None = None
    true: float | None = None
    low: float | None = None
    high: float | None = None
    published_estimated: float | None = None
    published_true: float | None = None
    published_low: float | None = None
    published_high: float | None = None
    target: float | None = None
    wanted: Side = "at most"  # side of the target on which the value must lie

    @classmethod
    def of(
        cls,
        experiment: str,
        quantity: str,
        unit: str,
        ours: Value,
        published: Value | None = None,
        *,
        target: float | None = None,
        wanted: Side = "at most",
        paper: float | None = None,
    ) -> "StudyRow":
        """Return the row of a figure; a share has its target only with enough runs to tell."""
        theirs = published or Value()
        if target is not None and ours.share_of is not None:
            target = target if can_be_judged(ours.share_of, target, wanted) else None
        return cls(
            experiment=experiment, quantity=quantity, unit=unit, paper=paper,
            true=ours.true, estimated=ours.estimated, low=ours.low, high=ours.high,
            published_true=theirs.true, published_estimated=theirs.estimated,
            published_low=theirs.low, published_high=theirs.high,
            target=target, wanted=wanted,
        )  # fmt: skip

    @property
    def named(self) -> str:
        """Quantity with its unit."""
        return self.quantity + (f" ({self.unit})" if self.unit else "")

    @property
    def verdict(self) -> Verdict | None:
        """Verdict on the target; None if there is none."""
        if self.target is None:
            return None
        value = self.estimated if self.true is None else self.true
        return verdict(value, self.low, self.high, self.target, self.wanted)

    @property
    def behind(self) -> bool:
        """Whether the published method is better in what has a target: the intervals are apart."""
        ends = self.low, self.high, self.published_low, self.published_high
        known = [each for each in ends if each is not None]
        if self.target is None or len(known) < len(ends):
            return False
        low, high, their_low, their_high = known
        return their_high < low if self.wanted == "at most" else high < their_low


def said_first(rows: Sequence[StudyRow]) -> str:
    """Return a sentence naming the figures in which the published method is better, or ""."""
    names = [f"{each.experiment}: {each.named}" for each in rows if each.behind]
    return f"The published method is better in {'; '.join(names)}." if names else ""


@dataclass(frozen=True, kw_only=True)
class StudyFigure:
    """A figure with its caption; ``name`` is the name of its file."""

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True, kw_only=True)
class Study:
    """Results of the reproduction of a paper."""

    paper: str  # name of its package
    title: str  # authors, title and place of publication
    rows: Sequence[StudyRow]  # in the order in which they are shown
    outcomes: Sequence[Outcome]  # of all cases, including failures
    figures: Sequence[StudyFigure] = ()
    compute_ms: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    notes: Sequence[str] = ()

    @property
    def experiments(self) -> dict[str, dict[str, Any]]:
        """Seeds (`seeds`), number of cases (`cases`) and of failures (`failed`) by experiment."""
        names = dict.fromkeys(each.case.experiment for each in self.outcomes)
        summary = {}
        for name in names:
            mine = [each for each in self.outcomes if each.case.experiment == name]
            summary[name] = {
                "seeds": sorted({each.case.seed for each in mine}),
                "cases": len(mine),
                "failed": sum(not each for each in mine),
            }
        return summary

    def as_json(self, command: str) -> dict[str, Any]:
        """Return everything except the pictures, for a JSON file."""
        return {
            "paper": self.paper,
            "title": self.title,
            "command": command,
            "version": version("sonoservo"),
            "drake": version("drake"),
            "made_with": dict(made_with()),
            "commit": present_commit(),
            "seeds": {name: each["seeds"] for name, each in self.experiments.items()},
            "rows": [
                {key: value for key, value in asdict(row).items() if key != "wanted"}
                | {"verdict": row.verdict, "wanted": row.wanted}
                for row in self.rows
            ],
            "cases": {
                name: {"cases": each["cases"], "failed": each["failed"]}
                for name, each in self.experiments.items()
            },
            "failures": [
                asdict(each.case) | {"error": each.error} for each in self.outcomes if not each
            ],
            "published_better": said_first(self.rows),
            "compute_ms": self.compute_ms,
            "wall_s": sum(each.wall_s for each in self.outcomes),
            "notes": list(self.notes),
        }


def read_notes(package: str, **figures: Any) -> list[str]:
    """Return the paragraphs of a study's ``notes.md``, in which its figures stand by name."""
    text = (files(package) / "notes.md").read_text(encoding="utf-8").format(**figures)
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n")]


def write_study(folder: Path, study: Study, command: str) -> dict[str, Any]:
    """Write a study to a folder: study.json, a PNG file for each figure, and report.html."""
    data = study.as_json(command)
    write_json(folder / "study.json", data)
    pictures = {}
    for each in study.figures:
        pictures[each.caption] = png(each.figure)
        write_atomically(folder / f"{each.name}.png", pictures[each.caption])
    write_atomically(folder / "report.html", study_page(study, command, pictures))
    return data


def study_page(study: Study, command: str, pictures: Mapping[str, bytes]) -> str:
    """Return a study as one self-contained HTML page."""
    facts = html.escape(f"{study.title} · sonoservo {version('sonoservo')} · {_met([study])}")
    return web_page(f"{study.paper} reproduced", facts, _body(study, command), pictures)


def write_studies(folder: Path, studies: Sequence[Study], command: str) -> dict[str, Any]:
    """Write studies to their own folders inside a folder, and one report of all of them."""
    data = {each.paper: write_study(folder / each.paper, each, command) for each in studies}
    pictures = {
        f"{each.paper}. {shown.caption}": png(shown.figure)
        for each in studies
        for shown in each.figures
    }
    bodies = (f"<h1>{html.escape(each.title)}</h1>{_body(each, command)}" for each in studies)
    facts = html.escape(f"sonoservo {version('sonoservo')} · {_met(studies)}")
    page = web_page("Papers reproduced", facts, "\n".join(bodies), pictures)
    write_atomically(folder / "report.html", page)
    return data


def _met(studies: Sequence[Study]) -> str:
    verdicts = (row.verdict for each in studies for row in each.rows)
    return summary_of([each for each in verdicts if each is not None])


def _body(study: Study, command: str) -> str:
    """Return the HTML of a study's command, notes and tables."""
    body = [f"<p><code>{html.escape(command)}</code></p>"]
    notes = [said_first(study.rows), *study.notes]
    body += [f"<p>{html.escape(note)}</p>" for note in notes if note]
    runs = [
        [name, _ranges(each["seeds"]), each["cases"], each["failed"]]
        for name, each in study.experiments.items()
    ]
    failed = [[each.case.name, each.case.seed, each.error] for each in study.outcomes if not each]
    times = [[name, *map(each.get, ("median", "max"))] for name, each in study.compute_ms.items()]
    for title, table in (
        ("Results", rows_table(study.rows)),
        ("Runs", Table(["", "seeds", "runs", "of these, failed"], runs)),
        ("Failed runs", Table(["", "seed", "error"], failed)),
        ("Computing time per volume (ms)", Table(["", "median", "max"], times, missing="–")),
    ):
        if table.rows:
            body.append(f"<h2>{title}</h2>{table.html()}")
    return "\n".join(body)


HEADS = (
    "experiment", "quantity", "paper", "ours, estimated", "ours, true", "95 %",
    "as published, estimated", "as published, true", "as published, 95 %", "target", "met",
)  # fmt: skip
"""Heads of `rows_table`."""


def rows_table(rows: Sequence[StudyRow]) -> Table:
    """Return the rows of a study as a table; an experiment stands in the first of its rows."""
    names = [row.experiment for row in rows]
    return Table(
        HEADS,
        [
            [
                "" if row.experiment == before else row.experiment,
                row.named,
                *(row.paper, row.estimated, row.true),
                interval_text(row.low, row.high),
                *(row.published_estimated, row.published_true),
                interval_text(row.published_low, row.published_high),
                "" if row.target is None else f"{_SIDES[row.wanted]} {row.target:g}",
                Strong(row.verdict) if row.verdict is Verdict.NOT_MET else row.verdict or "",
            ]
            for row, before in zip(rows, ["", *names], strict=False)
        ],
    )


_SIDES = {"at most": "≤", "at least": "≥"}


def interval_text(low: float | None, high: float | None) -> str:
    """Return an interval such as "0.40 to 0.60"; empty if there is none."""
    if low is None or high is None:
        return ""
    if low == -math.inf and high == math.inf:
        return "too few runs"
    return f"{cell_text(low)} to {cell_text(high)}"


def figure_text(
    figure: float | None, low: float | None, high: float | None, missing: str = "–"
) -> str:
    """Return a figure with its interval, such as "0.50 (0.40 to 0.60)", if enough runs tell one."""
    untold = None in (low, high) or low == math.inf or (low, high) == (-math.inf, math.inf)
    return cell_text(figure, missing) + ("" if untold else f" ({interval_text(low, high)})")


def _ranges(numbers: Sequence[int]) -> str:
    """Return numbers as ranges: [0, 1, 2, 5] becomes "0-2, 5"."""
    starts = [n for n in numbers if n - 1 not in numbers]
    ends = [n for n in numbers if n + 1 not in numbers]
    return ", ".join(
        str(start) if start == end else f"{start}-{end}"
        for start, end in zip(starts, ends, strict=True)
    )
