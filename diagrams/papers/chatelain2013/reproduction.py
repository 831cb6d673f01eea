"""Reproduction of Chatelain, Krupa and Marchal (ICRA 2013) over many seeds, with ground truth.

In addition to figs. 4, 5 and 6, there are bent needles, volumes without a needle, and the same
experiments with one part of the method switched off.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.papers.chatelain2013.report import report
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.store import Store
from sonoservo.diagrams.studies.study import Case, StudyOptions, WithFiles
from sonoservo.diagrams.studies.study_report import Study
from sonoservo.systems.evaluation.curve_error import curve_deviations
from sonoservo.systems.evaluation.log import encode_log
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

ABLATIONS: Mapping[str, Sequence[str]] = {
    "no filter": ["tracker.track.filtering=false"],
    "no volume of interest": ["tracker.localizer.volume_of_interest=false"],
    "no angle gate": ["tracker.localizer.angle_gate=false"],
    "no refits": ["tracker.localizer.ransac.refits=0"],
    "no sweep time": ["tracker.localizer.sweep_time=false"],
    "no feed-forward": ["controller.visual_servo.feed_forward=false"],
    "no feed-forward, filter in probe's frame": [
        "controller.visual_servo.feed_forward=false",
        "tracker.track.probe_frame=true",
    ],
}
"""Changes of the scenario by name of the ablation. A velocity in the probe's frame cannot be fed
forward, so the last ablation is to be compared with the one before."""

_NO_NEEDLE = ["hand.pushes=[]", "duration=44.5"]
_NUDGES = [
    {"start": 4.0 + 3 * k, "duration": 1.0, "translation": translation}
    for k, translation in enumerate(
        3 * [[0.002, 0.0, 0.0], [-0.002, 0.0, 0.002], [0.0, 0.002, -0.002], [0.0, -0.002, 0.0]]
    )
]


@dataclass(frozen=True)
class Protocol:
    """Protocol of one experiment.

    Parameters
    ----------
    scenario
        Name of the scenario.
    seeds
        Number of seeds.
    quick
        Number of seeds and duration in s of a quick study.
    changes
        Changes of the scenario.
    """

    scenario: str
    seeds: int
    quick: tuple[int, float]
    changes: Sequence[str] = ()


PROTOCOLS: Mapping[str, Protocol] = {
    "fig4": Protocol("chatelain2013_fig4", 20, (2, 32.0)),
    "fig5": Protocol("chatelain2013_fig5", 20, (2, 24.0)),
    "fig6": Protocol("chatelain2013_fig6", 50, (2, 25.0)),
    "bent": Protocol("chatelain2013_fig5", 20, (2, 16.0), ["tracker.order=3"]),
    # During the approach, the probe stops as soon as it touches.
    "no needle, probe still": Protocol(
        "chatelain2013_fig4",
        4,
        (1, 6.0),
        [
            *_NO_NEEDLE,
            "controller.force.proportional_gain=1e-9",
            "controller.force.integral_gain=0",
        ],
    ),
    "no needle, probe pressed": Protocol(
        "chatelain2013_fig4", 4, (1, 8.0), [*_NO_NEEDLE, f"phantom_motion.moves={_NUDGES}"]
    ),
    **{
        f"fig5, {name}": Protocol(
            "chatelain2013_fig5",
            20 if name == "no feed-forward" else 5,
            (1, 19.5 if name == "no feed-forward" else 12.0),
            changes,
        )
        for name, changes in ABLATIONS.items()
    },
    **{
        f"fig6, {name}": Protocol("chatelain2013_fig6", 5, (0, 0.0), changes)
        for name, changes in ABLATIONS.items()
    },
}


def reproduce(options: StudyOptions) -> Study:
    """Run the experiments, and compare them with the paper.

    Parameters
    ----------
    options
        Number of runs, folder and number of processes.
    """
    logs = options.folder / "logs"
    outcomes = run_cases(
        run_case,
        study_cases(options),
        options.folder / "cases",
        jobs=options.jobs,
        cluster=options.cluster,
        store=Store(str(logs)),
        console=options.console,
    )
    return report(outcomes, logs, list(ABLATIONS))


def study_cases(options: StudyOptions) -> list[Case]:
    """Return the cases to run."""
    cases = []
    for name, protocol in PROTOCOLS.items():
        seeds, duration = protocol.quick
        if options.quick and seeds == 0:
            continue
        for seed in options.seed_range(protocol.seeds, seeds):
            changes = [*protocol.changes, *([f"duration={duration}"] if options.quick else [])]
            if name == "bent":
                changes += bent_insertion(seed)
            cases.append(Case(name, seed, {"scenario": protocol.scenario, "changes": changes}))
    return cases


def bent_insertion(seed: int) -> list[str]:
    """Draw a bent needle, and return the changes that turn fig. 5's needle into it.

    The bevel's radius is between 150 and 400 mm, the elevation between 0 and 40 deg out of the
    horizontal, and the bend to any side. The tip ends at the same point as in fig. 5. The needle is
    as long as the phantom allows, and is pushed in the same time.
    """
    rng = np.random.default_rng([2013, seed])
    radius, dip, roll = rng.uniform([0.15, 0.0, -180.0], [0.4, 40.0, 180.0])
    tip, longest = np.array([-0.023, 0.0, -0.050]), 0.097
    down, side = np.deg2rad([dip, roll])
    forward = np.array([np.cos(down), 0, -np.sin(down)])
    upward = np.array([np.sin(down), 0, np.cos(down)])
    bend = np.cos(side) * upward + np.sin(side) * np.cross(forward, upward)
    for length in np.arange(longest, 0.04, -1e-3):
        turned = length / radius
        aside = 1 - np.cos(turned)
        entry = tip - radius * (np.sin(turned) * forward + aside * bend)
        if entry[0] >= -0.12 and -0.075 <= entry[2] <= 0:
            break
    speeds = np.array([0.008, 0.0, 0.005]) * length / longest
    return [
        f"hand.entry={entry.round(5).tolist()}",
        "hand.entry_spread=[0, 0, 0]",
        "hand.angle_spread_deg=0",
        f"hand.dip_deg={dip:.2f}",
        f"hand.bend_radius={radius:.4f}",
        f"hand.bend_roll_deg={roll:.2f}",
        *(f"hand.pushes.{k}.speed={speed:.5f}" for k, speed in enumerate(speeds)),
    ]


def run_case(case: Case) -> WithFiles:
    """Run a case's scenario.

    Parameters
    ----------
    case
        Case whose settings name a `scenario` and `changes` to it.

    Returns
    -------
    `summary`: figures as in summary.json; `curve_deviation`: see `curve_deviations`, in m; and the
    log as a file.
    """
    scenario = load_scenario(
        case.settings["scenario"], seed=case.seed, changes=case.settings["changes"]
    )
    experiment = FollowingExperiment(scenario)
    experiment.run()
    log, scenario = experiment.log(), experiment.scenario
    geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
    result = {
        "summary": experiment.summarize(log),
        "curve_deviation": curve_deviations(log, geometry),
    }
    return WithFiles(result, {f"{case.name}.npz": encode_log(log)})
