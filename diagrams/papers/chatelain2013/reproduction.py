"""Reproduction of Chatelain, Krupa and Marchal (ICRA 2013) over many seeds, with ground truth.

In addition to figs. 4, 5 and 6, there are bent needles, other directions, other settings of the
transducer, volumes without a needle, and fig. 5 with one part of our method switched off. All but
the last are run with the published method, too; it alone is run with other values of what the paper
leaves open.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED, run_case
from sonoservo.diagrams.studies.runs import run_study
from sonoservo.diagrams.studies.study import Case, Outcome, StudyOptions

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

SETTINGS: Mapping[str, Sequence[str]] = {
    "7 cm deep, 9 volumes/s": ["imaging.depth=0.07", "imaging.volume_rate=9"],
    "12 cm deep, 2.5 volumes/s": ["imaging.depth=0.12", "imaging.volume_rate=2.5"],
    "11 frames, 7 volumes/s": ["imaging.frames=11", "imaging.volume_rate=7"],
    "31 frames, 2 volumes/s": ["imaging.frames=31", "imaging.volume_rate=2"],
    "full sector, 3.3 volumes/s": ["imaging.sector=1.0", "imaging.volume_rate=3.3"],
}
"""Changes of the scenario by settings of the transducer: depth, sector, frames and rate."""

OPEN_VALUES: Mapping[str, tuple[str, str, Sequence[float | str]]] = {
    "sweeps of one direction: {}": ("fig5", "detection.same_direction={}", ("false",)),
    "candidates of a difference {} mm3": ("fig5", "detection.candidate_volume={}e-9", (2, 10, 30)),
    "delta {} mm": ("fig5", "detection.max_depth={}e-3", (5, 10)),
    "candidates of a volume {} mm3": (
        "fig5", "localization.candidate_volume={}e-9", (120, 250, 800)
    ),
    "tracked from {} mm on": ("fig5", "localization.min_length={}e-3", (10, 15, 25)),
    "gaps of {} mm": ("fig5", "localization.max_gap={}e-3", (1.5, 3)),
    "ends {} dB above its surroundings": ("fig5", "localization.end_contrast={}", (6, 12)),
    "alpha_0 {} deg": ("fig6", "localization.max_angle_deg={}", (10, 20, 50)),
    "margin {} mm": ("fig6", "localization.margin={}e-3", (10, 15)),
}  # fmt: skip
"""What the paper leaves open: scenario, field of the tracker, and values; chosen are others."""

_SOONER = ["duration=24"]
"""End of a run whose errors at rest are not reported; fig. 5's needle rests from 19 s on."""

_ONE_PUSH = ["duration=26", "hand.pushes=[{duration: 20.0, speed: 0.004}]"]
_NO_NEEDLE = ["hand.pushes=[]", "duration=44.5"]
_NUDGES = [
    {"start": 4.0 + 3 * k, "duration": 1.0, "translation": translation}
    for k, translation in enumerate(
        3 * [[0.002, 0.0, 0.0], [-0.002, 0.0, 0.002], [0.0, 0.002, -0.002], [0.0, -0.002, 0.0]]
    )
]


@dataclass(frozen=True)
class Protocol:
    """Protocol of one experiment: name of the scenario, number of seeds, and changes.

    `quick`: number of seeds and duration in s of a quick study; `drawn` draws further changes for a
    seed; `ours`, `compared`: whether our method and the published one are run.
    """

    scenario: str
    seeds: int
    quick: tuple[int, float]
    changes: Sequence[str] = ()
    drawn: Callable[[int], list[str]] | None = None
    ours: bool = True
    compared: bool = True


def bent_insertion(seed: int) -> list[str]:
    """Draw a bent needle, and return the changes that turn fig. 5's needle into it."""
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


def direction_of_insertion(seed: int) -> list[str]:
    """Draw the direction of a needle that passes below the probe, as changes of fig. 5."""
    azimuth, dip = np.random.default_rng([2013, seed, 1]).uniform([-50.0, 5.0], [50.0, 40.0])
    return [
        "station.probe={x: 0.0, y: 0.0, yaw_deg: 0.0, height: 0.010}",
        "hand.entry=null",
        "hand.entry_spread=[0, 0, 0]",
        "hand.angle_spread_deg=0",
        f"hand.azimuth_deg={azimuth:.2f}",
        f"hand.dip_deg={dip:.2f}",
    ]


PROTOCOLS: Mapping[str, Protocol] = {
    "fig4": Protocol("chatelain2013_fig4", 20, (1, 16.0)),
    "fig5": Protocol("chatelain2013_fig5", 50, (1, 23.0)),
    "fig6": Protocol("chatelain2013_fig6", 50, (1, 20.5)),
    "bent": Protocol(
        "chatelain2013_fig5", 50, (1, 12.0), ["tracker.order=3", *_SOONER], bent_insertion
    ),
    "directions": Protocol(
        "chatelain2013_fig5", 10, (1, 12.0), _SOONER, drawn=direction_of_insertion
    ),
    **{
        f"settings, {name}": Protocol("chatelain2013_fig4", 10, (1, 8.5), [*_ONE_PUSH, *changes])
        for name, changes in SETTINGS.items()
    },
    # During the approach, the probe stops as soon as it touches.
    "no needle, probe still": Protocol(
        "chatelain2013_fig4",
        4,
        (1, 5.0),
        [
            *_NO_NEEDLE,
            "controller.force.proportional_gain=1e-9",
            "controller.force.integral_gain=0",
        ],
    ),
    "no needle, probe pressed": Protocol(
        "chatelain2013_fig4", 4, (1, 7.0), [*_NO_NEEDLE, f"phantom_motion.moves={_NUDGES}"]
    ),
    **{
        f"fig5, {name}": Protocol(
            "chatelain2013_fig5",
            20,
            # The lag shows after the last push.
            {"no feed-forward": (1, 19.5), "no filter": (1, 9.0)}.get(name, (0, 9.0)),
            [*_SOONER, *changes],
            compared=False,
        )
        for name, changes in ABLATIONS.items()
    },
    **{
        f"open, {name.format(value)}": Protocol(
            f"chatelain2013_{scenario}",
            1,
            (1 if scenario == "fig5" and value == values[0] else 0, 9.0),
            [f"tracker.{change.format(value)}"],
            ours=False,
        )
        for name, (scenario, change, values) in OPEN_VALUES.items()
        for value in values
    },
}


def run(options: StudyOptions) -> list[Outcome]:
    """Run the experiments."""
    return run_study(run_case, study_cases(options), options, logs=options.folder / "logs")


def study_cases(options: StudyOptions) -> list[Case]:
    """Return the cases to run."""
    cases = []
    for name, protocol in PROTOCOLS.items():
        seeds, duration = protocol.quick
        for seed in options.seed_range(protocol.seeds, seeds):
            changes = [*protocol.changes, *([f"duration={duration}"] if options.quick else [])]
            changes += protocol.drawn(seed) if protocol.drawn else []
            settings = {"scenario": protocol.scenario, "changes": changes}
            if protocol.ours:
                cases.append(Case(name, seed, settings))
            if protocol.compared:
                cases.append(Case(name + AS_PUBLISHED, seed, settings | {"as_published": True}))
    return cases
