"""Reproduction of Carriere 2016: prediction of the final shape of needles.

Every case is one needle, with its own tissue, radius, first angle, plane and noise. The truth is
drawn with R uniform between 0.8 and 2.4 m and theta_0 uniform within 2 deg. This differs from the
estimators' prior (R normal, 1.5 and 0.6 m; theta_0 normal, 5 deg). All methods see the same slices.
Whole needles in the same tissue, which are not reported, first teach our particle filter how much
the curvature wanders.
"""

from dataclasses import asdict, replace
from typing import Any

from sonoservo.diagrams.papers.carriere2016.protocols import (
    LESSON_SEEDS,
    LESSONS,
    PROTOCOLS,
    QUICK_LESSON_SEEDS,
    SETS,
    SWEEP_SEEDS,
)
from sonoservo.diagrams.papers.carriere2016.runs import UNTAUGHT, run_needle, teach
from sonoservo.diagrams.studies.runs import run_study
from sonoservo.diagrams.studies.study import Case, Outcome, StudyOptions
from sonoservo.systems.shape.shape_posterior import WanderParameters, combined_wander


def run(options: StudyOptions) -> list[Outcome]:
    """Run the study."""
    lessons = _lessons(options)
    cases = []
    for name, protocol in PROTOCOLS.items():
        settings = {
            "scenario": protocol.scenario,
            "changes": list(protocol.changes),
            "whole": protocol.whole,
            "wander": lessons.get(protocol.learnt),
        }
        swept = (1 if options.quick else SWEEP_SEEDS) if name in SETS else 0
        for number, seed in enumerate(options.seed_range(protocol.seeds, protocol.quick)):
            more = {"sweeps": number < swept, "keep": number == 0}
            cases.append(Case(name, seed, {**settings, **more}))
    return run_study(run_needle, cases, options)


def _lessons(options: StudyOptions) -> dict[str, dict[str, Any]]:
    """Return the distribution of the wander after the whole needles in each kind of tissue."""
    seeds = QUICK_LESSON_SEEDS if options.quick else LESSON_SEEDS
    coarse = ["step=2e-3"] if options.quick else []
    cases = [
        Case(kind, seed, {"scenario": "carriere2016_d60", "changes": [*changes, *coarse]})
        for kind, changes in LESSONS.items()
        for seed in seeds
    ]
    outcomes = run_study(teach, cases, replace(options, only=""), folder="lessons")

    def learnt(kind: str) -> list[WanderParameters]:
        mine: list[Outcome] = [each for each in outcomes if each and each.case.experiment == kind]
        return [WanderParameters(**each.result) for each in mine]

    return {kind: asdict(combined_wander(UNTAUGHT, learnt(kind))) for kind in LESSONS}
