"""Report of the study of robustness: rows of three trackers, and their successes dial by dial."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sonoservo.diagrams.studies.robustness.analysis import Group, chased
from sonoservo.diagrams.studies.robustness.plots import study_figures
from sonoservo.diagrams.studies.robustness.runs import CLINIC, GRADED, OURS, PUBLISHED, TRACKERS
from sonoservo.diagrams.studies.run_group import Value
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyRow, read_notes
from sonoservo.systems.evaluation.success import (
    ENOUGH_MM,
    FOUND_DEG,
    FOUND_MM,
    KEPT,
    STANDS_OUT_DB,
    SUCCESS_DEG,
    SUCCESS_MM,
)

Groups = Mapping[str, Mapping[str, Group]]  # runs by experiment and kind of the tracker

_ERRORS: Sequence[tuple[str, str, Callable[[Group], Value]]] = (
    ("found", "%", lambda group: group.share(lambda run: run.found)),
    ("kept, while 10 mm or more stand out", "%", lambda group: group.share(lambda run: run.kept)),
    ("success", "%", lambda group: group.share(lambda run: run.success)),
    ("tip error, median", "mm", lambda group: group.quantile("tip", 0.5)),
    ("tip error, 95 %", "mm", lambda group: group.quantile("tip", 0.95)),
    ("axis error, median", "deg", lambda group: group.quantile("axis", 0.5)),
    ("axis error, 95 %", "deg", lambda group: group.quantile("axis", 0.95)),
    ("truth inside the stated 95 %, tip", "%", lambda group: group.inside("tip")),
    ("truth inside the stated 95 %, axis", "%", lambda group: group.inside("axis")),
    ("truth inside the stated 95 %, velocity", "%", lambda group: group.inside("velocity")),
)
_FALSE_STARTS: tuple[str, str, Callable[[Group], Value]] = (
    "false starts", "1/h", Group.false_starts_per_hour
)  # fmt: skip
_GHOSTS: Sequence[tuple[str, str, Callable[[Group], Value]]] = (
    (
        "needle shown while none is in the image, mean",
        "s",
        lambda group: group.mean(lambda run: run.shown_s),
    ),
)
_TRAVEL: Sequence[tuple[str, str, Callable[[Group], Value]]] = (
    (
        "travel after a needle that is not in the image, mean",
        "mm",
        lambda group: group.mean(lambda run: run.travel_mm or 0.0),
    ),
    (
        "travel after a needle that is not in the image, largest",
        "mm",
        lambda group: group.largest(lambda run: run.travel_mm or 0.0),
    ),
    ("runs with 10 mm of such travel or more", "%", lambda group: group.share(chased)),
)


@dataclass(frozen=True, kw_only=True)
class RobustnessStudy(Study):
    """Study of robustness, with each tracker's successes dial by dial; see `Study`."""

    dials: Sequence[Mapping[str, str]] = field(default_factory=tuple)

    def as_json(self, command: str) -> dict[str, Any]:
        """Return everything except the pictures, for a JSON file."""
        return super().as_json(command) | {"dials": [dict(each) for each in self.dials]}


def report(outcomes: Sequence[Outcome], folder: Path | None = None) -> RobustnessStudy:
    """Return the study of finished runs; without its folder, there are no figures."""
    groups = group_outcomes(outcomes)
    curves = dial_curves([each for each in outcomes if _is_shared(each)])
    rows = [row for name, trackers in groups.items() for row in _rows(name, trackers)]
    return RobustnessStudy(
        paper="robustness",
        title=TITLE,
        rows=rows,
        outcomes=outcomes,
        figures=study_figures(curves, groups) if folder else (),
        notes=_notes(),
        dials=[_successes(name, curve) for name, curve in dial_curves(outcomes).items()],
    )


def group_outcomes(outcomes: Sequence[Outcome]) -> dict[str, dict[str, Group]]:
    """Return the runs of each experiment and tracker; a scene of all trackers is a run of each."""
    sorted_out: dict[str, dict[str, list[Outcome]]] = {}
    for each in outcomes:
        for kind in each.case.settings["trackers"]:
            trackers = sorted_out.setdefault(each.case.experiment, {})
            trackers.setdefault(kind, []).append(each)
    return {
        name: {kind: Group(trackers[kind], kind) for kind in TRACKERS if kind in trackers}
        for name, trackers in sorted_out.items()
    }


Curve = list[tuple[float, Mapping[str, Group]]]  # strength and runs by tracker, the weakest first


def dial_curves(outcomes: Sequence[Outcome]) -> dict[str, Curve]:
    """Return the runs of the open loop by dial and strength; "plain" and clinic are dials too."""
    groups = group_outcomes(outcomes)
    curves: dict[str, dict[float, Mapping[str, Group]]] = {}
    for each in outcomes:
        settings = each.case.settings
        if settings["loop"] == "open" and "dial" in settings:
            points = curves.setdefault(settings["dial"], {})
            points[settings["strength"]] = groups[each.case.experiment]
    return {
        name: sorted(points.items(), key=lambda each: each[0]) for name, points in curves.items()
    }


def _successes(name: str, curve: Curve) -> dict[str, str]:
    """Return how many runs of each tracker succeed at each strength of a dial, in words."""
    dial = GRADED.get(name)
    return {
        "dial": {"plain": "none", CLINIC: f"all (`{CLINIC}`)"}.get(name, name),
        "unit": dial.unit if dial else "",
        "strengths": ", ".join(dial.words(each, unit=False) for each, _ in curve) if dial else "",
        "moderate": dial.words(1.0, unit=False) if dial else "",
        **{kind: ", ".join(_of(groups.get(kind)) for _, groups in curve) for kind in TRACKERS},
    }


def _of(group: Group | None) -> str:
    return f"{sum(run.success for run in group.runs)}/{group.total}" if group else "-"


def _is_shared(outcome: Outcome) -> bool:
    """Return True if all trackers saw the scene, so that they are compared like for like."""
    return set(outcome.case.settings["trackers"]) == set(TRACKERS)


def _rows(experiment: str, trackers: Mapping[str, Group]) -> list[StudyRow]:
    """Return the rows of an experiment: ours beside the published tracker, then the others'."""
    figures = [] if "without" in experiment else list(_ERRORS)
    if experiment == "withdrawals":  # a needle that is thrown aside cannot be kept
        figures = [each for each in figures if not each[0].startswith(("kept", "success"))]
    figures.append(_FALSE_STARTS)
    if not experiment.startswith("open"):
        figures += [*_GHOSTS, *_TRAVEL]
    rows = []
    for quantity, unit, figure in figures:
        values = {
            kind: figure(group)
            for kind, group in trackers.items()
            if "travel" not in quantity or _moves(group)
        }
        rows += _compared(experiment, quantity, unit, values)
    return rows


def _compared(
    experiment: str, quantity: str, unit: str, figures: Mapping[str, Value]
) -> list[StudyRow]:
    """Return a row of ours beside the published tracker's figure, and one of each other's."""
    ours, published = (figures.get(kind, Value()) for kind in (OURS, PUBLISHED))
    others = (kind for kind in TRACKERS[2:] if kind in figures)
    return [
        StudyRow.of(experiment, quantity, unit, ours, published),
        *(StudyRow.of(experiment, f"{quantity}, {kind}", unit, figures[kind]) for kind in others),
    ]


def _moves(group: Group) -> bool:
    """Return True if the probe follows the tracker."""
    return any(each.travel_mm is not None for each in group.runs)


TITLE = "Robustness: one dial of the harder world at a time, and all of them in the clinic"


def _notes() -> list[str]:
    """Return the paragraphs of the report."""
    return read_notes(
        "sonoservo.diagrams.studies.robustness",
        found_mm=FOUND_MM, found_deg=FOUND_DEG, kept=100 * KEPT, enough_mm=ENOUGH_MM,
        stands_out_db=STANDS_OUT_DB, success_mm=SUCCESS_MM, success_deg=SUCCESS_DEG,
    )  # fmt: skip
