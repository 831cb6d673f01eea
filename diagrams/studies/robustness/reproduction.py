"""Study of robustness: one dial at a time, a clinic, withdrawals, and volumes without a needle.

The whole study of 1382 runs takes about three hours on 2 cores.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sonoservo.diagrams.studies.robustness.runs import (
    CLINIC,
    GRADED,
    OURS,
    PLAIN,
    TRACKERS,
    run_case,
    turned,
)
from sonoservo.diagrams.studies.runs import run_study
from sonoservo.diagrams.studies.study import Case, Outcome, StudyOptions

OPEN_SEEDS, CLOSED_SEEDS = (10, 1), (6, 1)
"""Number of seeds of each dial and strength, in the whole study and in a quick one."""

MODERATE_SEEDS, CLINIC_SEEDS, OTHERS_SEEDS = (30, 1), (50, 1), (10, 1)
"""Number of seeds of the open loop at moderate strength or with every dial off, and in the clinic;
and of those that the other trackers see too."""

CALIBRATED_SEEDS = (10, 1)
"""Number of seeds with poses as they are measured, and with corrected ones."""

CLOSED_CLINIC_SEEDS = (30, 1)  # number of runs with our tracker

WITHDRAWALS, OTHERS_WITHDRAWALS = (50, 1), (10, 1)
"""Number of withdrawals with our tracker, and with each of the others."""

NEEDLE_FREE, PART = 3000.0, 300.0  # time without a needle in all, and in one run, in s

OTHERS_PARTS = 2
"""Number of these runs in which the other trackers run, too; they take as long as all else."""

_QUICK_PART = 10.0  # time of a quick run without a needle, in s

_SCENARIO = "chatelain2013_fig5"
_OPEN = {True: ["hand.start=1.5", "duration=12.5"], False: ["hand.start=1.5", "duration=13.5"]}
_CLOSED = {True: ["duration=15.5"], False: ["duration=17.0"]}
"""Changes of a dial's scenario (True) and of the clinic (False). Without a robot, nothing has to
land, and the needle comes sooner."""

_CALIBRATED = ("pose delay", "hand-eye calibration")
"""Dials that the tissue itself shows, and that a tracker can correct."""

_LONG = [
    "hand.pushes=[{duration: 6.25, speed: 0.008}, {duration: 14, speed: 0.002}]",
    "hand.start=1.5",
    "duration=23",
]
"""Changes of the scenario in which poses are calibrated: the probe follows a slow second push."""

_QUICK_DIALS = ("faint needle", "breathing", "hand-eye calibration", "speed of sound")
"""Dials of a quick study."""


def run(options: StudyOptions) -> list[Outcome]:
    """Run the study."""
    return run_study(run_case, study_cases(options), options)


def study_cases(options: StudyOptions) -> list[Case]:
    """Return the cases to run."""
    return [
        *_open_cases(options),
        *_calibration_cases(options),
        *_closed_cases(options),
        *_withdrawals(options),
        *_without_needle(options),
    ]


def withdrawal(seed: int) -> list[str]:
    """Draw the changes by which the phantom moves and the needle is withdrawn."""
    rng = np.random.default_rng([2027, seed])
    drawn = rng.uniform([0.02, 0, 0.6, 0.015], [0.04, 2, 1.2, 0.03])
    distance, side, duration, speed = (float(each) for each in drawn)
    x, y = distance * np.array([np.cos(np.pi * side), np.sin(np.pi * side)])
    moved, push = 12.0, 7.0
    start = moved - push - 1.0
    rest = moved + duration + 1.0 - start - push
    out = 0.14 / speed
    pushes = [
        {"duration": push, "speed": 0.008},
        {"duration": round(rest, 3), "speed": 0.0},
        {"duration": round(out, 3), "speed": round(-speed, 5)},
    ]
    translation = [float(round(x, 4)), float(round(y, 4)), 0.0]
    moves = [{"start": moved, "duration": round(duration, 3), "translation": translation}]
    return [
        f"hand.start={start}",
        f"hand.pushes={pushes}",
        f"phantom_motion.moves={moves}",
        "duration=24",
    ]


def _dial(name: str, strength: float) -> dict[str, Any]:
    """Return the settings of a dial at a strength; see `run_case`."""
    if name in (CLINIC, "plain"):
        scenario = CLINIC if name == CLINIC else _SCENARIO
        judged = {"in_probe": True, "across_depth": True} if name == CLINIC else {}
        return {"scenario": scenario, "changes": [*([] if name == CLINIC else PLAIN)]} | judged
    settings = turned(name, strength)
    judged = dict.fromkeys(GRADED[name].judged, True)
    return {"scenario": _SCENARIO, **settings, "changes": [*PLAIN, *settings["changes"]], **judged}


def _more(settings: Mapping[str, Any], changes: list[str], **more: Any) -> dict[str, Any]:
    return {**settings, "changes": [*settings["changes"], *changes], **more}


def _points(quick: bool) -> list[tuple[str, float]]:
    """Return names and strengths of the open loop's dials, with everything off and all on."""
    names = _QUICK_DIALS if quick else tuple(GRADED)
    turned = [(name, each) for name in names for each in GRADED[name].strengths]
    return [("plain", 0.0), *turned, (CLINIC, 0.5)]


def _open_cases(options: StudyOptions) -> list[Case]:
    cases = []
    shared = options.seed_range(*OTHERS_SEEDS)
    for name, strength in _points(options.quick):
        settings = _dial(name, strength)
        changes = _OPEN[name != CLINIC]
        settings = _more(settings, changes, loop="open", dial=name, strength=strength)
        moderate = MODERATE_SEEDS if name == "plain" or strength == 1.0 else OPEN_SEEDS
        for seed in options.seed_range(*(CLINIC_SEEDS if name == CLINIC else moderate)):
            trackers = [*TRACKERS] if seed in shared else [OURS]
            experiment = _experiment("open loop", name, strength)
            cases.append(Case(experiment, seed, {**settings, "trackers": trackers}))
    return cases


def _calibration_cases(options: StudyOptions) -> list[Case]:
    cases = []
    for name in _CALIBRATED[1:] if options.quick else _CALIBRATED:
        settings = _more(_dial(name, 1.0), _LONG, loop="open", trackers=[OURS])
        for words, corrects in (("poses as measured", False), ("poses corrected", True)):
            cases += [
                Case(_experiment(words, name, 1.0), seed, {**settings, "correct_poses": corrects})
                for seed in options.seed_range(*CALIBRATED_SEEDS)
            ]
    return cases


def _closed_cases(options: StudyOptions) -> list[Case]:
    cases = []
    names = ("faint needle",) if options.quick else ("plain", *GRADED, CLINIC)
    for name in names:
        settings = _more(_dial(name, 1.0), _CLOSED[name != CLINIC], loop="closed", dial=name)
        for tracker in TRACKERS:
            more = tracker == OURS and name == CLINIC
            cases += [
                Case(_experiment("closed loop", name, 1.0), seed, _with(settings, tracker))
                for seed in options.seed_range(*(CLOSED_CLINIC_SEEDS if more else CLOSED_SEEDS))
            ]
    return cases


def _withdrawals(options: StudyOptions) -> list[Case]:
    cases = []
    for tracker in TRACKERS:
        numbers = WITHDRAWALS if tracker == OURS else OTHERS_WITHDRAWALS
        for seed in options.seed_range(*numbers):
            settings = _more(_dial("plain", 0.0), withdrawal(seed), loop="closed")
            cases.append(Case("withdrawals", seed, _with(settings, tracker)))
    return cases


def _without_needle(options: StudyOptions) -> list[Case]:
    part = _QUICK_PART if options.quick else PART
    changes = ["hand.pushes=[]", "hand.initial_depth=0", f"duration={part}"]
    settings = _more(_dial(CLINIC, 1.0), changes, loop="search")
    seeds = options.seed_range(round(NEEDLE_FREE / PART), 1)
    watched = options.seed_range(OTHERS_PARTS, 1)
    return [
        Case(
            "clinic without a needle",
            seed,
            {**settings, "trackers": [*TRACKERS] if seed in watched else [OURS]},
        )
        for seed in seeds
    ]


def _with(settings: Mapping[str, Any], tracker: str) -> dict[str, Any]:
    return _more(settings, [f"tracker={tracker}"], trackers=[tracker])


def _experiment(loop: str, name: str, strength: float | None = None) -> str:
    """Return the name of an experiment, such as "open loop, drag 2 mm"."""
    if strength is None or name not in GRADED:
        return f"{loop}, {name}"
    return f"{loop}, {name} {GRADED[name].words(strength)}"
