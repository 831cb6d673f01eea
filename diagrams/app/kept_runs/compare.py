"""Comparison of kept runs: what was changed between them, their figures, and their curves."""

import html
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.table import Table as TerminalTable

from sonoservo.diagrams.app.run_result import table_text
from sonoservo.diagrams.experiments.presenter import Presenter
from sonoservo.diagrams.experiments.registry import (
    experiment_class,
    load_scenario,
    presenter_class,
)
from sonoservo.diagrams.experiments.scenario_changes import changed_fields
from sonoservo.diagrams.scenario import Scenario
from sonoservo.systems.evaluation.labels import look_up, sections
from sonoservo.systems.evaluation.log import Log, read_log
from sonoservo.systems.evaluation.reports.plots import png
from sonoservo.systems.evaluation.reports.report import picture, web_page
from sonoservo.systems.evaluation.table import Code, Strong, Table, cell_text
from sonoservo.systems.files.refusals import ConfigurationError, refusing_failures
from sonoservo.systems.files.writing import write_atomically, write_json

_FILES = ("scenario.yaml", "summary.json", "log.npz")


@dataclass(frozen=True, eq=False)
class KeptResults:
    """Name of a run in the comparison, and summary, scenario and log from its folder."""

    name: str
    scenario: Scenario
    summary: Mapping[str, Any]
    log: Log


@dataclass(frozen=True, eq=False)
class Comparison:
    """Comparison of at least two runs of one experiment."""

    runs: Sequence[KeptResults]

    @property
    def presenter(self) -> type[Presenter]:
        """Class that presents the runs."""
        return presenter_class(self._kind)

    @property
    def names(self) -> list[str]:
        """Names of the runs."""
        return [each.name for each in self.runs]

    def changes(self) -> list[dict[str, str]]:
        """Return the fields in which the scenarios differ: path, meaning, and value by run."""
        first, *others = self.runs
        rows: dict[str, dict[str, str]] = {}
        for run in others:
            for change in changed_fields(first.scenario, run.scenario, seed=True):
                new = {"path": change.path, "meaning": change.meaning}
                row = rows.setdefault(change.path, new | dict.fromkeys(self.names, change.before))
                row[run.name] = change.after
        return list(rows.values())

    def figures(self) -> dict[str, list[Any]]:
        """Return the figures of all runs, one list each, by their dotted paths."""
        paths = self.presenter.labels
        return {path: [look_up(each.summary, path) for each in self.runs] for path in paths}

    def plot(self) -> Figure:
        """Return the curves of all runs over one another."""
        return self.presenter.overlay({each.name: each.log for each in self.runs})

    def table(self) -> TerminalTable:
        """Return the differences and the figures, for a terminal."""
        changes = [[row["path"], *self._values(row)] for row in self.changes()]
        labels, empty = self.presenter.labels, [""] * len(self.names)
        rows = [[labels[path], *map(cell_text, each)] for path, each in self._known().items()]
        differ = "What differs between the scenarios" if changes else "The scenarios do not differ"
        heads = [[Strong(each), *empty] for each in (differ, "Figures")]
        table = Table(["", *self.names], [heads[0], *changes, heads[1], *rows]).terminal(
            " and ".join(self.names), widest=None
        )
        table.rows[len(changes)].end_section = True
        for column in table.columns:  # names of fields are long
            column.overflow = "fold"
        return table

    def _known(self) -> dict[str, list[Any]]:
        """Return the figures that at least one run has."""
        return {
            path: each
            for path, each in self.figures().items()
            if any(cell_text(v, "") for v in each)
        }

    def _values(self, row: Mapping[str, str]) -> list[str]:
        return [row[name] for name in self.names]

    def as_json(self) -> dict[str, Any]:
        """Return the comparison for a JSON file."""
        return {"runs": self.names, "changes": self.changes(), "figures": self.figures()}

    def page(self) -> str:
        """Return the comparison as one self-contained HTML page."""
        title = f"Comparison of {', '.join(self.names)}"
        facts = html.escape(f"{len(self.runs)} runs of the experiment {self._kind!r}")
        return web_page(title, facts, self._repr_html_(), {})

    @property
    def _kind(self) -> str:
        return self.runs[0].scenario.experiment

    def __str__(self) -> str:
        return table_text(self.table())

    def _repr_html_(self) -> str:
        heads = self.names
        changes = [
            [row["meaning"], Code(row["path"]), *self._values(row)] for row in self.changes()
        ]
        parts = ["<h2>What differs between the scenarios</h2>"]
        shown = Table(["", "field", *heads], changes).html()
        parts.append(shown if changes else "<p>Nothing.</p>")
        parts += ["<h2>Curves</h2>", picture(self.presenter.overlay_caption, png(self.plot()))]
        figures, labels = self._known(), self.presenter.labels
        parts.append("<h2>Figures</h2>")
        for heading, group in sections({path: labels[path] for path in figures}).items():
            rows = [[label, *figures[path]] for path, label in group.items()]
            shown = Table(["", *heads], rows, missing="–").html()
            parts.append(f"<h3>{html.escape(heading)}</h3>\n{shown}")
        return "\n".join(parts)


def compare(folders: Sequence[str | Path], out: str | Path | None = None) -> Comparison:
    """Compare two or more kept runs of one experiment.

    The folder ``out``, if given, gets report.html and comparison.json. ConfigurationError if a
    folder is not that of a run, or the runs are not of one experiment.
    """
    if isinstance(folders, str | Path):
        raise ConfigurationError(f"folders: {str(folders)!r} is one path; expected a list of them")
    paths = [Path(each) for each in folders]
    if len(paths) < 2:
        raise ConfigurationError(f"folders: {len(paths)} given; a comparison needs at least two")
    runs = [read_kept_results(path, name) for path, name in zip(paths, _names(paths), strict=True)]
    kinds = {each.scenario.experiment: each.name for each in runs}
    if len(kinds) > 1:
        (one, first), (other, second), *_ = kinds.items()
        raise ConfigurationError(
            f"{first} is a run of the experiment {one!r}, {second} of {other!r}; only runs of one "
            "experiment can be compared"
        )
    comparison = Comparison(runs)
    if out is not None:
        write_json(Path(out) / "comparison.json", comparison.as_json())
        write_atomically(Path(out) / "report.html", comparison.page())
    return comparison


def read_kept_results(folder: Path, name: str = "") -> KeptResults:
    """Read the results of a run from its folder, whose name is the run's by default."""
    if not folder.is_dir():
        raise ConfigurationError(f"{folder}: there is no such folder")
    if (folder / "estimates.csv").is_file():
        raise ConfigurationError(
            f"{folder} is a folder of track, not of run; its report.html has the pictures, and "
            "sonoservo track SOURCE --show shows the volumes again"
        )
    if missing := [each for each in _FILES if not (folder / each).is_file()]:
        raise ConfigurationError(
            f"{folder} is not the folder of a run that has ended: it has no {missing[0]}"
        )
    scenario = load_scenario(folder / "scenario.yaml")
    with refusing_failures(folder / "summary.json", "cannot be read"):
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        if not isinstance(summary, dict):
            raise TypeError("it holds no figures by name")
    log = read_log(folder / "log.npz", experiment_class(scenario.experiment).log_class)
    return KeptResults(name or folder.name, scenario, summary, log)


def _names(paths: Sequence[Path]) -> list[str]:
    """Return the names of the folders, or their whole paths where names are equal."""
    names = [Path(os.path.realpath(path)).name for path in paths]  # also of links in a circle
    if len(set(names)) == len(names):
        return names
    whole = [str(path) for path in paths]
    return (
        whole if len(set(whole)) == len(whole) else [f"{n + 1}: {p}" for n, p in enumerate(whole)]
    )
