"""Kept results of papers and studies, and the tables of the documentation that show them.

The results of a paper or study are the file ``results.json`` in its package, made by ``sonoservo
reproduce all --keep``, or by its own name instead of "all". The tables name the commit that made
them, and say so if the code that makes them has changed since.
"""

import json
import re
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sonoservo.diagrams.studies.fingerprint import study_fingerprint, study_room
from sonoservo.diagrams.studies.verdicts import Verdict, summary_of, verdict
from sonoservo.systems.evaluation.reports.web_page import cell_text
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_atomically, write_json

_ROOT = Path(__file__).resolve().parents[2]

PAGES = (_ROOT / "README.md", _ROOT / "notebooks/docs/results.md")
"""Pages with tables of results."""

_TABLE = re.compile(r"<!-- results (\w+) (\w+) -->\n.*?<!-- end of results -->", re.S)

_NONE = "*There are no results yet. `sonoservo reproduce {} --keep` makes them, in hours.*"

CHANGED = " *The code that makes these results has changed since.*"
"""Note beside results that the present code did not make."""

_HEADS = (
    "experiment", "quantity", "paper", "ours, estimated", "ours, true", "95 %",
    "as published, estimated", "as published, true", "95 %", "target", "met",
)  # fmt: skip

_MAIN_FIGURES = {
    "found (%)": ("found", ""),
    "kept (%)": ("kept, while 10 mm or more stand out", ""),
    "success (%)": ("success", ""),
    "success, as published (%)": ("success", "published_"),
    "success, zhao2012 (%)": ("success, zhao2012", ""),
    "tip error, median (mm)": ("tip error, median", ""),
    "tip error, 95 % (mm)": ("tip error, 95 %", ""),
    "tip inside the stated 95 % (%)": ("truth inside the stated 95 %, tip", ""),
    "false starts (1/h)": ("false starts", ""),
    "runs that chase nothing (%)": ("runs with 10 mm of such travel or more", ""),
}
"""Quantities of the study of robustness that judge a tracker, each with the prefix of its keys."""


def keep_results(results: Mapping[str, Mapping[str, Any]]) -> None:
    """Keep the results of papers in their packages, and write the tables that show them.

    Parameters
    ----------
    results
        Contents of study.json by paper.

    Raises
    ------
    ConfigurationError
        If the program was not started from a checkout of its repository, or if the results come
        from several commits, from files that were not committed or from other code than the present
        one. Failed runs are no reason: they are part of the statistics, and their number is kept.
    """
    if not (_ROOT / "pyproject.toml").is_file():
        raise ConfigurationError("--keep: results are kept in a checkout of the repository only")
    commits = sorted({data["commit"] for data in results.values()})
    if len(commits) > 1:
        raise ConfigurationError(f"--keep: results come from {len(commits)} commits: {commits}")
    if commits and commits[0].endswith("+"):
        raise ConfigurationError(f"--keep: the code of {commits[0]} was not committed")
    if stale := [
        name for name in results if results[name]["fingerprint"] != study_fingerprint(name)
    ]:
        raise ConfigurationError(f"--keep: other code than the present one made {stale[0]}")
    for paper, data in results.items():
        write_json(_results_path(paper), {key: data[key] for key in data if key != "failures"})
    write_tables()


def kept_results(paper: str) -> dict[str, Any] | None:
    """Return the kept results of a paper; None if there are none."""
    path = _results_path(paper)
    if not path.is_file():
        return None
    kept: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return kept


def is_outdated(kept: Mapping[str, Any]) -> bool:
    """Return True if results were made by other code than the present one.

    With another version of Drake than the one that made them, nobody can tell.

    Parameters
    ----------
    kept
        Contents of study.json.
    """
    same_drake = kept["drake"] == version("drake")
    return bool(same_drake and kept["fingerprint"] != study_fingerprint(kept["paper"]))


def results_table(kept: Mapping[str, Any], rows: str) -> str:
    """Return results as Markdown: where they come from, whether that is outdated, and a table.

    Parameters
    ----------
    kept
        Contents of study.json.
    rows
        "all"; "published" for those with a figure of the paper; in the study of robustness,
        "thresholds" for the strengths at which success ends, and "experiments" for a line with the
        main figures of each experiment.
    """
    numbers = sorted({len(seeds) for seeds in kept["seeds"].values()})
    seeds = " to ".join(map(str, dict.fromkeys((numbers[0], numbers[-1]))))
    source = f"Commit {kept['commit'][:10]}, `{kept['command']}`, {seeds} seeds an experiment"
    changed = CHANGED if is_outdated(kept) else ""
    if rows == "thresholds":
        return f"{source}.{changed}\n\n{_thresholds_table(kept['thresholds'])}"
    if rows == "experiments":
        return f"{source}.{changed}\n\n{_experiments_table(kept)}"
    verdicts = [each for row in kept["rows"] if (each := _verdict(row)) is not None]
    lines = []
    before = ""
    for row in kept["rows"]:
        if rows == "published" and row["paper"] is None:
            continue
        lines.append(_cells(row, before))
        before = row["experiment"]
    return f"{source}: {summary_of(verdicts)}.{changed}\n\n{_markdown_table(_HEADS, lines)}"


def write_tables() -> None:
    """Write the tables of all `PAGES` anew."""
    for page in PAGES:
        write_atomically(page, with_tables(page.read_text(encoding="utf-8")))


def with_tables(text: str) -> str:
    """Return a page with its tables as the kept results give them.

    Parameters
    ----------
    text
        Page with marks ``<!-- results PAPER ROWS -->`` and ``<!-- end of results -->``.
    """

    def table(found: re.Match[str]) -> str:
        paper, rows = found.groups()
        kept = kept_results(paper)
        made_by = "all" if study_room(paper) == "papers" else paper
        content = _NONE.format(made_by) if kept is None else results_table(kept, rows)
        return f"<!-- results {paper} {rows} -->\n{content}\n<!-- end of results -->"

    return _TABLE.sub(table, text)


def _thresholds_table(thresholds: Sequence[Mapping[str, str]]) -> str:
    """Return the dials' thresholds as Markdown, with a column for each tracker."""
    heads = list(dict.fromkeys(key for each in thresholds for key in each))
    return _markdown_table(heads, [[each.get(key, "") for key in heads] for each in thresholds])


def _experiments_table(kept: Mapping[str, Any]) -> str:
    """Return the `_MAIN_FIGURES` of each experiment as Markdown, with their intervals."""
    experiments: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in kept["rows"]:
        experiments.setdefault(row["experiment"], {})[row["quantity"]] = row
    lines = []
    for name, seeds in kept["seeds"].items():
        cells = [name, str(len(seeds))]
        for quantity, prefix in _MAIN_FIGURES.values():
            row = experiments[name].get(quantity, {})
            figure, low, high = (row.get(prefix + key) for key in ("true", "low", "high"))
            known = figure is not None and low is not None
            cells.append(_figure(figure) + (f" ({_interval(low, high)})" if known else ""))
        lines.append(cells)
    return _markdown_table(["experiment", "seeds", *_MAIN_FIGURES], lines)


def _markdown_table(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown; bars in cells are escaped."""
    escaped = [[cell.replace("|", r"\|") for cell in cells] for cells in lines]
    head, *body = (f"| {' | '.join(cells)} |" for cells in (heads, *escaped))
    return "\n".join([head, "|" + "---|" * len(heads), *body])


def _cells(row: Mapping[str, Any], before: str) -> list[str]:
    quantity = row["quantity"] + (f" ({row['unit']})" if row["unit"] else "")
    target = "" if row["target"] is None else f"{_SIDES[row['wanted']]} {row['target']:g}"
    return [
        row["experiment"] if row["experiment"] != before else "",
        quantity,
        *(_figure(row[key]) for key in ("paper", "estimated", "true")),
        _interval(row["low"], row["high"]),
        *(_figure(row[key]) for key in ("published_estimated", "published_true")),
        _interval(row["published_low"], row["published_high"]),
        target,
        "**no**" if _verdict(row) is Verdict.NOT_MET else _verdict(row) or "",
    ]


def _verdict(row: Mapping[str, Any]) -> Verdict | None:
    """Return the verdict on a row's target by today's definition; None if it has none."""
    if row["target"] is None:
        return None
    value = row["estimated"] if row["true"] is None else row["true"]
    return verdict(value, row["low"], row["high"], row["target"], row["wanted"])


_SIDES = {"at most": "≤", "at least": "≥"}


def _figure(value: float | None) -> str:
    if value is None:
        return ""
    return cell_text(value) if value else "0"


def _interval(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ""
    return f"{'-∞' if low is None else _figure(low)} to {'∞' if high is None else _figure(high)}"


def _results_path(paper: str) -> Path:
    return _folder(paper) / "results.json"


def _folder(paper: str) -> Path:
    return _ROOT / "diagrams" / study_room(paper) / paper
