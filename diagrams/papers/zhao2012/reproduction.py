"""Reproduction of Zhao, Liebgott and Cachard (Acoustics 2012), and their tracker in a closed loop.

>>> sonoservo reproduce zhao2012 --quick
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sonoservo.diagrams.papers.zhao2012.report import report
from sonoservo.diagrams.papers.zhao2012.runs import run_case
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.study import Case, StudyOptions
from sonoservo.diagrams.studies.study_report import Study

PUBLISHED_SPEEDS = 15 * [1.0]
"""Published speeds in mm/s between 16 volumes, in which the needle grows from 5 to 20 mm."""

SPEEDS = (0.5, 2.0, 3.0, 5.0)
"""Further constant speeds, in mm/s."""

KEPT_MM3 = (10, 20, 40, 60, 100, 160, 250)
"""Total volumes of the voxels that thresholding keeps, in mm^3."""

DIRECTIONS = ([0.94, 0.2, -0.28], [0.71, 0.0, -0.71], [0.34, 0.34, -0.88])
"""Further directions of the needle, in T."""


def reproduce(options: StudyOptions) -> Study:
    """Run the experiments, and compare them with the paper."""
    outcomes = run_cases(
        run_case,
        study_cases(options),
        options.folder / "cases",
        jobs=options.jobs,
        cluster=options.cluster,
        console=options.console,
    )
    return report(outcomes)


def study_cases(options: StudyOptions) -> list[Case]:
    """Return the cases to run."""
    quick = options.quick
    lengths = [5, 12, 20] if quick else list(range(5, 21))
    static = {"lengths_mm": lengths, "volumes": 4 if quick else 5}
    dynamic = {"speeds_mm_s": PUBLISHED_SPEEDS}
    cases = []
    for seed in options.seed_range(50, 2):
        for name, settings in (("static", static), ("dynamic", dynamic)):
            fresh, same = {"phantom": seed}, {"phantom": options.first_seed}
            cases.append(Case(f"{name}, fresh speckle", seed, settings | fresh))
            cases.append(Case(f"{name}, same volumes", seed, settings | same))
    for seed in options.seed_range(20, 1):
        for name, more in _conditions(seed).items():
            settings = {**dynamic, **more, "phantom": seed}
            cases.append(Case(f"dynamic, {name}", seed, settings))
        for length_mm in (10, 20):
            settings = {"length_mm": length_mm, "kept_mm3": list(KEPT_MM3), "phantom": seed}
            cases.append(Case(f"kept voxels, {length_mm} mm", seed, settings))
    for tracker in ("chatelain2013", "zhao2012"):
        for seed in options.seed_range(10, 1):
            changes = [f"tracker={tracker}", *(["duration=20"] if quick else [])]
            scenario = {"scenario": "chatelain2013_fig5", "changes": changes}
            cases.append(Case(f"closed loop, {tracker}", seed, scenario))
    return cases


def _conditions(seed: int) -> Mapping[str, Mapping[str, Any]]:
    """Return the settings of the conditions besides the published ones, for a seed."""
    varying = (1 + 0.9 * np.sin(2 * np.pi * np.arange(15) / 6)).round(3).tolist()
    constant = {
        f"{speed:g} mm/s": {"speeds_mm_s": min(8, int(20 / speed)) * [speed]} for speed in SPEEDS
    }
    return {
        "varying speed": {"speeds_mm_s": varying},
        "varying speed, commanded": {"speeds_mm_s": varying, "commanded": True},
        "other directions": {"direction": DIRECTIONS[seed % len(DIRECTIONS)]},
        "other depths": {"deeper_mm": (-6, 6)[seed % 2]},
        **constant,
    }
