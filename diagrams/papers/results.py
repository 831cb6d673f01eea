"""Kept results of papers and studies, and the tables of the documentation that show them.

A paper's or study's package keeps a record of each run, made by ``sonoservo reproduce all --keep``,
or by its own name instead of "all"; so does the benchmark. The tables are made of the records
by the present definitions. They name the commit that made the runs, and say so if the code of the
runs has changed since.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from html import escape
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from numba import config

from sonoservo.diagrams.papers.registry import STUDIES, module_of
from sonoservo.diagrams.published import PAPERS
from sonoservo.diagrams.studies.fingerprint import RECORDS, is_outdated, made_with
from sonoservo.diagrams.studies.records import (
    Records,
    kept_commit,
    present_code,
    present_records,
    read_records,
    write_records,
)
from sonoservo.diagrams.studies.study import Case, Outcome
from sonoservo.diagrams.studies.study_report import (
    Study,
    StudyRow,
    figure_text,
    rows_table,
    summary_of,
)
from sonoservo.systems.evaluation.table import Table
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_atomically

_ROOT = Path(__file__).resolve().parents[2]

PAGES = (_ROOT / "README.md", *sorted((_ROOT / "notebooks/docs").glob("results_*.md")))
"""Pages with tables of results."""

BENCHMARK = "benchmark"
"""Name of the benchmark, which keeps its records as a study does."""

_TABLE = re.compile(r"<!-- results (\w+) (\w+) -->\n.*?<!-- end of results -->", re.S)

_NONE = "*There are no results yet. `sonoservo {} --keep` makes them, in hours.*"

CHANGED = " *The code that makes these results has changed since.*"
"""Note beside results that the present code did not make."""

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


def keep_records(
    outcomes: Mapping[str, Sequence[Outcome]], command: str, *, adds: str = ""
) -> None:
    """Keep records of runs in the packages that made them, and write the tables made of them.

    They replace those that are kept, or are added to them: a "part" of what was missing, or all the
    "rest", so that the command alone makes what is kept.
    """
    _require_checkout()
    for name, each in outcomes.items():
        if adds:
            records = _joined(name, each, command, whole=adds == "rest")
        else:
            records = present_records(each, command)
        write_records(_path(name), records)
    write_tables()


def require_addable(name: str) -> Records:
    """Return the records of a study; ConfigurationError if more of them cannot be added."""
    _require_checkout()
    return _joined(name, (), "")


def _joined(
    name: str, outcomes: Sequence[Outcome], command: str, *, whole: bool = False
) -> Records:
    """Return the kept records of a study with further ones; one made again takes its own place."""
    kept = require_records(name, "--add")
    runs = by_case([*kept.outcomes, *outcomes])
    command = command if whole else f"{kept.command}; {command}"
    return present_records([*runs.values()], command, kept.repeats)


def by_case(outcomes: Sequence[Outcome]) -> dict[str, Outcome]:
    """Return outcomes by the digits of their cases; of one case, the last."""
    return {case_digits(each.case): each for each in outcomes}


def case_digits(case: Case) -> str:
    """Return the contents of a case with as many digits as records have."""
    return json.dumps(json.loads(case.key, parse_float=lambda text: f"{float(text):.6g}"))


def kept_records(name: str) -> Records | None:
    """Return the records of the kept runs of a paper, a study or the benchmark; None if none."""
    return read_records(_path(name))


def require_records(name: str, option: str) -> Records:
    """Return the records of the kept runs of a study; ConfigurationError if there are none."""
    records = kept_records(name)
    if records is None:
        raise ConfigurationError(f"{option}: no records of runs are kept of {name}")
    return records


def keep_repeat(name: str, runs: int) -> None:
    """Keep beside a study's records that so many of its runs, made again now, gave the same.

    The tables then say so, and no longer that the code has changed. ConfigurationError outside a
    checkout, if nothing is kept, or if the present code is not committed.
    """
    commit, records = require_keepable(), require_records(name, "--keep")
    write_records(_path(name), _with_repeat(records, commit, runs))
    write_tables()


def keep_refreshed(name: str, outcomes: Sequence[Outcome], runs: int, *, whole: bool) -> None:
    """Keep runs of a study in place of those of the same cases, and how many others are the same.

    The note about changed code goes if the ``whole`` study was refreshed. Errors are those of
    `keep_repeat`.
    """
    commit, records = require_keepable(), require_records(name, "--refresh")
    joined = replace(records, outcomes=[*by_case([*records.outcomes, *outcomes]).values()])
    if not any(is_outdated(each.made_by) for each in joined.outcomes):
        joined = replace(joined, commit=commit, version=version("sonoservo"), repeats=())
    elif whole:
        joined = _with_repeat(joined, commit, runs)
    write_records(_path(name), joined)
    write_tables()


def _with_repeat(records: Records, commit: str, runs: int) -> Records:
    """Return records with the note of a repeat, which replaces one by the same code."""
    modules = dict.fromkeys(each.made_by["module"] for each in records.outcomes)
    by = {"code": present_code(modules), "for": config.CPU_NAME or made_with()["instruction set"]}
    others = [each for each in records.repeats if {**each, **by} != each]
    return replace(records, repeats=[*others, {**by, "commit": commit, "runs": runs}])


def _renewed(records: Records) -> dict[str, int]:
    """Return how many of the runs are by commits that made them again, as figures had changed."""
    code = Counter(
        (each.made_by["module"], each.made_by["sonoservo's code"]) for each in records.outcomes
    )
    made = {
        each["commit"]: sum(code[by] for by in each["code"].items()) for each in records.repeats
    }
    return {
        commit: number for commit, number in made.items() if number and number < sum(code.values())
    }


def require_keepable() -> str:
    """Return the commit of the present code; ConfigurationError if no results of it can be kept."""
    _require_checkout()
    return kept_commit()


def _require_checkout() -> None:
    if not (_ROOT / "pyproject.toml").is_file():
        raise ConfigurationError("--keep: results are kept in a checkout of the repository only")


def results_table(kept: Mapping[str, Any], rows: str) -> str:
    """Return results as Markdown: where they come from, whether they are outdated, and a table.

    `kept`: contents of study.json; `rows`: "all" rows, folded by experiment; "published" ones, with
    a figure of the paper; of the study of robustness, "dials" or "experiments".
    """
    numbers = sorted({len(seeds) for seeds in kept["seeds"].values()})
    seeds = " to ".join(map(str, dict.fromkeys((numbers[0], numbers[-1]))))
    seeds += " seeds" if numbers[-1] > 1 else " seed"
    seeds = f", {seeds} an experiment"
    if rows == "dials":
        return f"{_source(kept, seeds)}\n\n{_dials_table(kept['dials'])}"
    if rows == "experiments":
        return f"{_source(kept, seeds)}\n\n{_experiments_table(kept)}"
    study_rows = [_row(each) for each in kept["rows"]]
    met = summary_of([each.verdict for each in study_rows if each.verdict is not None])
    shown = [each for each in study_rows if rows != "published" or each.paper is not None]
    head = f"{_source(kept, f'{seeds}: {met}')}\n\n"
    if rows == "published":
        return head + _first_table(shown).markdown()
    groups: dict[str, list[StudyRow]] = {}
    for each in shown:
        groups.setdefault(each.experiment, []).append(each)
    behind = kept.get("published_better")
    head += f"{behind}\n\n" if behind else ""
    return head + "\n\n".join(_folded(name, each) for name, each in groups.items())


def _source(kept: Mapping[str, Any], more: str = "") -> str:
    """Return the sentences on what made kept results, and whether they are outdated."""
    said = f"Commit {kept['commit'][:10]}, `{kept['command']}`{more}."
    said += CHANGED if kept.get("outdated") else ""
    if renewed := kept.get("renewed"):
        by = ", ".join(f"{number} by {commit[:10]}" for commit, number in renewed.items())
        said += f" Runs made again since, as their figures had changed: {by}."
    for each in kept.get("repeats", ()):
        said += (
            f" {each['runs']} of the runs, made again by commit {each['commit'][:10]} "
            f"({each['for']}), gave the same figures."
        )
    return said


def _first_table(rows: Sequence[StudyRow]) -> Table:
    """Return the rows in five columns, for README."""
    lines = []
    for row in rows:
        true = figure_text(row.true, row.low, row.high, "")
        name = f"{row.experiment}: {row.named}"
        lines.append([name, row.paper, row.estimated, true, row.published_true])
    heads = ["quantity", "paper", "ours, estimated", "ours, true (95 %)", "as published, true"]
    return Table(heads, lines)


def _folded(experiment: str, rows: Sequence[StudyRow]) -> str:
    """Return the table of one experiment, which a click on its line unfolds."""
    verdicts = [each.verdict for each in rows if each.verdict is not None]
    judged = f": {summary_of(verdicts)}" if verdicts else ""
    table = rows_table(rows).without(["experiment"]).markdown()
    summary = f"<summary>{escape(experiment)}{judged}</summary>"
    return f"<details>\n{summary}\n\n{table}\n\n</details>"


def write_tables() -> None:
    """Write the tables of all `PAGES` anew."""
    _tables.cache_clear()
    for page in PAGES:
        write_atomically(page, with_tables(page.read_text(encoding="utf-8")))


def with_tables(text: str) -> str:
    """Return a page with the tables between its marks as the kept results give them."""

    def table(found: re.Match[str]) -> str:
        name, rows = found.groups()
        tables = _tables(name)
        content = tables(rows) if tables else _NONE.format(_KEPT[name].command)
        return f"<!-- results {name} {rows} -->\n{content}\n<!-- end of results -->"

    return _TABLE.sub(table, text)


_Tables = Callable[[str], str]
"""Function from a choice of rows to kept results as Markdown, by the present definitions."""


@cache
def _tables(name: str) -> _Tables | None:
    """Return the tables of kept results; None if none are kept."""
    records = kept_records(name)
    if records is None:
        return None
    made = {
        "command": records.command,
        "commit": records.commit,
        "outdated": records.is_outdated,
        "repeats": records.present_repeats,
        "renewed": _renewed(records),
    }
    return _KEPT[name].tables(name, records.outcomes, made)


def _study_tables(name: str, outcomes: Sequence[Outcome], made: dict[str, Any]) -> _Tables:
    study: Study = module_of(name, "report").report(outcomes)
    return partial(results_table, study.as_json(made["command"]) | made)


def _benchmark_tables(name: str, outcomes: Sequence[Outcome], made: dict[str, Any]) -> _Tables:
    scores = import_module(f"sonoservo.diagrams.{name}.report").kept_markdown(outcomes)
    return lambda rows: f"{_source(made)}\n\n{scores}"


@dataclass(frozen=True)
class _Kept:
    """Something of which records are kept: its folder, its command, and the tables made of it."""

    folder: str
    command: str
    tables: Callable[[str, Sequence[Outcome], dict[str, Any]], _Tables]


_KEPT = {
    **{name: _Kept(f"papers/{name}", "reproduce all", _study_tables) for name in PAPERS},
    **{name: _Kept(f"studies/{name}", f"reproduce {name}", _study_tables) for name in STUDIES},
    BENCHMARK: _Kept(BENCHMARK, BENCHMARK, _benchmark_tables),
}


def _dials_table(dials: Sequence[Mapping[str, str]]) -> str:
    """Return the successes dial by dial as Markdown, with a column for each tracker."""
    return Table([*dials[0]], [[*each.values()] for each in dials]).markdown()


def _experiments_table(kept: Mapping[str, Any]) -> str:
    """Return the `_MAIN_FIGURES` of each experiment as Markdown, with their intervals."""
    experiments: dict[str, dict[str, StudyRow]] = {}
    for row in map(_row, kept["rows"]):
        experiments.setdefault(row.experiment, {})[row.quantity] = row
    lines = []
    for name, seeds in kept["seeds"].items():
        cells = [name, str(len(seeds))]
        for quantity, prefix in _MAIN_FIGURES.values():
            found = experiments[name].get(quantity)
            keys = (prefix + key for key in ("true", "low", "high"))
            true, low, high = (getattr(found, key, None) for key in keys)
            cells.append(figure_text(true, low, high, ""))
        lines.append(cells)
    return Table(["experiment", "seeds", *_MAIN_FIGURES], lines).markdown()


def _row(kept: Mapping[str, Any]) -> StudyRow:
    """Return a row from study.json, which has no infinite numbers."""
    known = {each.name: kept[each.name] for each in fields(StudyRow) if each.name in kept}
    for prefix in ("", "published_"):
        low, high = known.get(f"{prefix}low"), known.get(f"{prefix}high")
        if (low is None) != (high is None):
            known[f"{prefix}low"] = -math.inf if low is None else low
            known[f"{prefix}high"] = math.inf if high is None else high
    return StudyRow(**known)


def _path(name: str) -> Path:
    return _ROOT / "diagrams" / _KEPT[name].folder / RECORDS
