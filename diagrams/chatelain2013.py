"""Chatelain, Krupa and Marchal (ICRA 2013): their experiments over seeds, with the truth beside.

>>> sonoservo reproduce chatelain2013 --quick
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sonoservo.diagrams.experiment import Experiment
from sonoservo.diagrams.scenario import load_scenario
from sonoservo.diagrams.study import Case, Outcome, StudyOptions, run_cases
from sonoservo.diagrams.study_report import Study, StudyRow
from sonoservo.systems.recording.metrics import MetricsParameters, summarize
from sonoservo.systems.recording.run_log import write_log

TITLE = (
    "Chatelain, Krupa and Marchal, Real-time needle detection and tracking using a visually "
    "servoed 3D ultrasound probe (ICRA 2013)"
)


def reproduce(options: StudyOptions) -> Study:
    """Run the experiments, and compare them with the paper."""
    cases = [
        Case("fig5", seed, {"scenario": "chatelain2013_fig5", "changes": []})
        for seed in options.seed_range(20, 2)
    ]
    outcomes = run_cases(
        partial(run_case, logs=options.folder / "logs"),
        cases,
        options.folder / "cases",
        jobs=options.jobs,
        console=options.console,
    )
    return Study(paper="chatelain2013", title=TITLE, rows=_at_rest(outcomes), outcomes=outcomes)


def run_case(case: Case, *, logs: Path) -> Mapping[str, Any]:
    """Run a case's scenario; keep its log and return its summary."""
    scenario = load_scenario(
        case.settings["scenario"], seed=case.seed, changes=case.settings["changes"]
    )
    experiment = Experiment(scenario)
    experiment.run()
    log = experiment.log()
    write_log(logs / f"{case.name}.npz", log)
    target = scenario.controller.force.force
    return summarize(log, MetricsParameters(force_target=target))


def _at_rest(outcomes: list[Outcome]) -> list[StudyRow]:
    def mean(block: str, key: str) -> float | None:
        values = [each.result["servo"][block][key] for each in outcomes if each]
        known = [value for value in values if value is not None]
        return float(np.mean(known)) if known else None

    return [
        StudyRow(
            experiment="fig5",
            quantity=f"at rest, mean |{name}|",
            unit=unit,
            paper=paper,
            estimated=mean("at_rest_estimated", key),
            true=mean("at_rest", key),
            target=target,
        )
        for name, key, unit, paper, target in (
            ("X", "x_mm", "mm", 1.10, 0.6),
            ("Z", "z_mm", "mm", 0.23, 0.2),
            ("Theta", "theta_deg", "deg", 0.97, 0.6),
        )
    ]
