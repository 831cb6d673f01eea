"""Reproduction of Zhao, Liebgott and Cachard (Acoustics 2012), and their tracker in a closed loop.

Run it by ``sonoservo reproduce zhao2012``; ``--quick`` makes a short one.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sonoservo.diagrams.papers.zhao2012.runs import run_case
from sonoservo.diagrams.papers.zhao2012.speed_report import INTERACTING, NO_VELOCIMETER
from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED
from sonoservo.diagrams.studies.runs import run_study
from sonoservo.diagrams.studies.study import Case, Outcome, StudyOptions

INTERVAL = 0.3
"""Time in s between volumes, of which the paper says nothing. The published search for the speckle
reaches 0.14 mm in depth, which is 0.42 mm along the needle. So its 1 mm/s was seen at no less than
2.4 volumes a second."""

PUBLISHED_SPEEDS = 50 * [1.0]
"""Published speed in mm/s between volumes in which the needle grows from 5 to 20 mm."""

SPEEDS = (0.5, 2.0, 3.0, 5.0)
"""Further constant speeds, in mm/s."""

KEPT_MM3 = (10, 20, 40, 60, 100, 160, 250)
"""Total volumes of the voxels that thresholding keeps, in mm^3."""

NOISES: Mapping[str, Mapping[str, float]] = {
    **{f"R ({1e3 * std:g} mm/s)^2": {"velocity_std": std} for std in (5e-5, 1.5e-4, 5e-4, 2e-3)},
    **{f"Q {tip:g} m^2/s^3": {"tip": tip} for tip in (1e-10, 1e-8, 1e-7)},
    **{f"Q {turning:g} rad^2/s": {"turning": turning} for turning in (2e-5, 2e-4)},
}
"""Changes of the published filter's `Noise` by values of what the paper leaves open."""

DIRECTIONS = ([0.94, 0.2, -0.28], [0.71, 0.0, -0.71], [0.34, 0.34, -0.88])
"""Further directions of the needle, in T."""


LOOP_PUSHES: Mapping[str, tuple[float, Sequence[tuple[float, float]]]] = {
    "0 to 8 mm/s": (19.5, ((6.0, 9.0), (2.5, 0.0), (3.0, 2.0), (3.0, 5.0), (2.7, 8.0))),
    "10 and 15 mm/s": (14.6, ((5.0, 9.0), (1.5, 0.0), (2.6, 10.0), (1.5, 0.0), (1.8, 15.0))),
}
"""Duration of a run in the loop in s, and duration in s and speed in mm/s of each of its pushes.
The first push brings the needle into view."""


def run(options: StudyOptions) -> list[Outcome]:
    """Run the experiments."""
    return run_study(run_case, study_cases(options), options, logs=options.folder / "logs")


def study_cases(options: StudyOptions) -> list[Case]:
    """Return the cases to run."""
    quick = options.quick
    lengths = [5, 12, 20] if quick else list(range(5, 21))
    static = {"lengths_mm": lengths, "volumes": 4 if quick else 5}
    speeds = PUBLISHED_SPEEDS[: 20 if quick else None]
    dynamic = {"speeds_mm_s": speeds, "interval_s": INTERVAL}
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
    push = {"speed_mm_s": 1.0, "interval_s": INTERVAL, "volumes": 12 if quick else 51}
    for seed in options.seed_range(6, 1):
        open_values = {**push, "noises": dict(NOISES), "phantom": seed}
        cases.append(Case("open values", seed, open_values))
    return cases + _loop_cases(options)


def _loop_cases(options: StudyOptions) -> list[Case]:
    """Return the cases in the loop of Chatelain 2013's fig. 5."""
    cases = []
    short = ["duration=23"] if options.quick else []

    def add(name: str, seed: int, *changes: str, compared: bool = True) -> None:
        settings = {"scenario": "chatelain2013_fig5", "changes": list(changes)}
        cases.append(Case(name, seed, settings))
        if compared:
            cases.append(Case(name + AS_PUBLISHED, seed, settings | {"as_published": True}))

    for seed in options.seed_range(10, 1):
        add("closed loop", seed, "tracker=zhao2012", *short)
    for seed in options.seed_range(6, 1):
        for name, (duration, pushes) in LOOP_PUSHES.items():
            changes = [f"duration={duration}", "hand.start=2", f"hand.pushes={_as_yaml(pushes)}"]
            add(f"speed in the loop, {name}", seed, "tracker=zhao2012", *changes)
            for ending, kind in ((NO_VELOCIMETER, "axis_tip"), (INTERACTING, "interacting")):
                tracker = ("tracker=chatelain2013", f"tracker.filter={{kind: {kind}}}")
                ours = f"speed in the loop, {name}{ending}"
                add(ours, seed, *tracker, *changes, compared=False)
    return cases


def _as_yaml(pushes: Sequence[tuple[float, float]]) -> str:
    """Return pushes of a duration in s and a speed in mm/s, as the value of ``hand.pushes``."""
    each = (f"{{duration: {time}, speed: {1e-3 * speed:g}}}" for time, speed in pushes)
    return f"[{', '.join(each)}]"


def _conditions(seed: int) -> Mapping[str, Mapping[str, Any]]:
    """Return the settings of the conditions besides the published ones, for a seed."""
    varying = (1 + 0.9 * np.sin(2 * np.pi * np.arange(15) / 6)).round(3).tolist()
    constant = {f"{speed:g} mm/s": {"speeds_mm_s": 8 * [speed]} for speed in SPEEDS}
    return {
        "varying speed": {"speeds_mm_s": varying},
        "varying speed, commanded": {"speeds_mm_s": varying, "commanded": True},
        "other directions": {"direction": DIRECTIONS[seed % len(DIRECTIONS)]},
        "other depths": {"deeper_mm": (-6, 6)[seed % 2]},
        **constant,
    }
