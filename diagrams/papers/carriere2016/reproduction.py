"""Reproduction of Carriere 2016: prediction of the final shape of needles.

Every case is one needle, with its own tissue, radius, first angle, plane and noise. The truth is
drawn with R uniform between 0.8 and 2.4 m and theta_0 uniform within 2 deg. This differs from the
estimators' prior (R normal, 1.5 and 0.6 m; theta_0 normal, 5 deg). The particle filter guides the
tracker; the other two estimators then receive the same cross-sections.
"""

from typing import Any

from sonoservo.diagrams.papers.carriere2016.report import make_study
from sonoservo.diagrams.papers.carriere2016.runs import SETS, UNEVEN, run_needle
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.study import Case, StudyOptions
from sonoservo.diagrams.studies.study_report import Study

NEEDLES, UNEVEN_NEEDLES, QUICK_NEEDLES = 100, 30, 4


def reproduce(options: StudyOptions) -> Study:
    """Run the study.

    Parameters
    ----------
    options
        Folder, number of needles and number of processes.
    """
    cases = [
        Case(name, seed, _settings(name, seed == options.first_seed))
        for name in (*SETS, UNEVEN)
        for seed in options.seed_range(NEEDLES if name in SETS else UNEVEN_NEEDLES, QUICK_NEEDLES)
    ]
    outcomes = run_cases(
        run_needle,
        cases,
        options.folder / "runs",
        jobs=options.jobs,
        cluster=options.cluster,
        console=options.console,
    )
    return make_study(outcomes)


def _settings(name: str, first: bool) -> dict[str, Any]:
    changes = []
    if name == UNEVEN:
        name, changes = SETS[0], ["hand.curvature_wander=0.1"]
    return {"scenario": f"carriere2016_{name}", "changes": changes, "keep_particles": first}
