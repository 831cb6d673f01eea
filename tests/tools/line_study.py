"""Study of the belief about lines: where needles are lost, and what is believed that is none.

``PYTHONPATH=tests/helpers:tests/tools python -m line_study clinic faint --seeds 100 104``
acquires sequences, keeps them, and prints a row for each. It is for tuning: seeds from 100 on.
``_APPEARS`` of the belief is the mean of its last column. ``--tails`` prints what ``_TAIL`` of the
contrasts was chosen by: how probable the changes of levels are before a needle comes.
"""

import argparse
import pickle
from dataclasses import dataclass
from itertools import pairwise
from math import gamma
from pathlib import Path
from unittest import mock

import numpy as np

from sonoservo.diagrams.benchmark.sequence import load_suites
from sonoservo.diagrams.experiments.following_scene import make_scene, observer_events
from sonoservo.diagrams.studies.robustness.planned_motion import MotionPlan, simulate_planned
from sonoservo.diagrams.studies.robustness.runs import scenario_of
from sonoservo.systems.evaluation.run_errors import at_times, in_frame
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.evaluation.success import conspicuous_length
from sonoservo.systems.recording import VolumeCollector
from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES
from sonoservo.systems.signals.volume import acquired_from
from sonoservo.systems.tracking import line_belief, line_contrast
from sonoservo.systems.tracking.line_belief import LineBelief, follow
from sonoservo.systems.tracking.line_fit import fitted_lines

SETTLED = 4.0
"""Time in s for which a sequence goes on after the first push."""

ASIDE, ANGLE_DEG, BEYOND = 3e-3, 10.0, 8e-3
"""Distance and angle within which a line is a needle's, and how far beyond its ends it may lie."""

ACT, CONSPICUOUS = 0.95, 10e-3
"""Probability at which a needle is believed, and length in m from which on it is conspicuous."""

AGE = 4
"""Number of volumes after which it is known whether a new line had appeared at once."""

BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Borders of the stated probabilities that are compared with how often a line is a needle."""


@dataclass(frozen=True)
class SearchingPlan(MotionPlan):
    """The probe moves to and fro over the phantom, at up to 6 mm/s and 4 deg/s, from 2 s on."""

    def _over(self, time):
        start = self.scenario.station.probe
        x, y, turn = np.sin(2 * np.pi * max(time - 2.0, 0.0) / np.array([31.0, 23.0, 37.0]))
        return self._placed((start.x + 0.025 * x, start.y + 0.012 * y, start.yaw_deg + 20 * turn))


class StillPlan(MotionPlan):
    """The probe is held still."""

    def _over(self, time):
        return self._placed(None)


WITHDRAWN = (
    "hand.pushes=[{duration: 5.0, speed: 0.01}, {duration: 1.0, speed: 0.0}, "
    "{duration: 4.0, speed: -0.0125}, {duration: 5.0, speed: 0.01}]"
)

STEPS = ", ".join(7 * ["{duration: 1.0, speed: 0.006}, {duration: 4.0, speed: 0.0}"])

KINDS = {
    "clinic": ("clinic", MotionPlan, (), None),
    "moving": ("clinic", SearchingPlan, ("hand.start=8.0",), None),
    "free": ("clinic", SearchingPlan, ("hand.start=1000.0",), 20.0),
    "faint": ("faint", MotionPlan, ("scanner.needle.specular_db=28.0",), None),
    "fast": ("fast", MotionPlan, (), None),
    "wire": ("guide wire", MotionPlan, (), None),
    "withdrawn": ("clean", MotionPlan, (WITHDRAWN,), 17.0),
    "clean": ("clean", MotionPlan, (), None),
    "slow": ("clean", StillPlan, ("hand.pushes=[{duration: 60.0, speed: 0.001}]",), 34.0),
    "steps": ("clean", StillPlan, (f"hand.pushes=[{STEPS}]",), 34.0),
}
"""Suite, plan of the probe, changes and duration in s of each kind of sequence."""


def acquire(kind, seed):
    """Return volumes, each with the needle's (m, 3) points in P or None, and how much stands out.

    Points run from entry to tip, as the volume shows them; lengths are in m.
    """
    suite, plan, changes, until = KINDS[kind]
    settings = load_suites([suite])[suite].settings()
    settings["changes"] = [*settings["changes"], *changes]
    with scenario_of(settings, seed) as scenario:
        scene, looks = make_scene(scenario), observer_events(scenario)
        plan = plan(scenario, scene.insertion)
        logger, collector = RunLogger(geometry=scene.geometry), VolumeCollector(**looks)
        simulator = simulate_planned(
            scenario, scene, plan, {"volume_collector": collector, "run_logger": logger},
            until=until or plan.begin + SETTLED,
            optional={logger.get_input_port(k).get_name() for k in range(logger.num_input_ports())},
        )  # fmt: skip
        context = simulator.get_context()
        volumes = list(collector.volumes(collector.GetMyContextFromRoot(context)))
        log = logger.log(logger.GetMyContextFromRoot(context))
    times = np.array([volume.time for volume in volumes])
    poses, points = at_times(log, log.X_WP, times), at_times(log, log.needle_points, times)
    recording = []
    for volume, pose, p in zip(volumes, poses, points, strict=True):
        needle, length = None, 0.0
        if np.isfinite(p).all():
            X = np.broadcast_to(pose, (len(p), 4, 4))
            needle = acquired_from(volume, volume.X_WP.multiply(in_frame(X, p).T).T)
            length = conspicuous_length(volume, needle)
        recording.append((volume, needle, length))
    return recording


def recorded(kind, seed, folder):
    """Return what `acquire` does, acquired only if the folder does not have it."""
    path = Path(folder) / f"{kind}_{seed}.pickle"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_bytes(pickle.dumps(acquire(kind, seed), protocol=5))
        part.rename(path)
    return pickle.loads(path.read_bytes())


def is_needle(ends, needle):
    """Return (n,) flags of (n, 2, 3) lines in P that lie along a needle, (m, 3) points in P."""
    if needle is None:
        return np.zeros(len(ends), bool)
    k = needle[-1] - needle[0]
    length = np.linalg.norm(k)
    k = k / length
    middle, along = ends.mean(axis=1) - needle[0], ends[:, 1] - ends[:, 0]
    a = middle @ k
    away = np.linalg.norm(middle - np.outer(a, k), axis=1)
    turn = np.abs(along @ k) / np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    there = (a > -BEYOND) & (a < length + BEYOND)
    return (away < ASIDE) & (turn > np.cos(np.radians(ANGLE_DEG))) & there


def study(recording):
    """Return figures of a recording, and (n, 2) stated probabilities with what was right.

    ``visible`` volumes show 10 mm of the needle. ``fitted`` is the share of them in which a fit
    lies along the needle, ``followed`` that in which a line that is followed does, and ``believed``
    that in which such a line is believed. ``found_s`` counts from the first visible volume.
    ``false`` lines are believed and lie along no needle. ``appear`` is how often a new line
    appeared at once, by volume, relative to how often a bin is drawn anew, before the needle is
    seen.
    """
    belief, shares, false, stated = LineBelief(), [], set(), []
    begun, found_s, born, appeared, renewed, times = np.inf, np.nan, {}, [], [], []
    for volume, needle, length in recording:
        fits = []

        def fitted(volume, cells, fits=fits):
            fits += fitted_lines(volume, cells)
            return fits

        with mock.patch.object(line_belief, "fitted_lines", fitted):
            belief = follow(belief, volume)
        lines = belief.hypotheses
        if length == 0:
            renewed.append(belief.memory[-1].change.renewed)
            times.append(volume.time)
            for number, classes in zip(lines.numbers, lines.classes, strict=True):
                if len(renewed) - born.setdefault(number, len(renewed)) == AGE:
                    share = classes[LINE_CLASSES.index("appeared")]
                    first = belief.memory[0].volume.time
                    appeared.append(share / np.sum(np.array(times) > first))
        ends = acquired_from(volume, lines.ends.reshape(-1, 3)).reshape(-1, 2, 3)
        right, sure = is_needle(ends, needle), lines.probabilities > ACT
        false.update(lines.numbers[sure & ~right])
        if len(ends):
            best = lines.probabilities.argmax()
            stated.append((lines.probabilities[best], right[best]))
        if (sure & right).any() and np.isnan(found_s):
            found_s = volume.time - min(begun, volume.time)
        if length >= CONSPICUOUS:
            begun = min(begun, volume.time)
            along = is_needle(np.array([fit.ends for fit in fits]).reshape(-1, 2, 3), needle)
            shares.append((along.any(), right.any(), (sure & right).any()))
    seen = np.mean(shares, axis=0) if shares else np.full(3, np.nan)
    row = {"volumes": len(recording), "visible": len(shares)}
    row |= dict(zip(("fitted", "followed", "believed"), seen, strict=True))
    row |= {"found_s": found_s, "false": len(false)}
    row["appear"] = np.mean(appeared) / np.median(renewed) if appeared else np.nan
    return row, stated


def tails(recording, freedoms=(2, 3, 4, 5, 8, 30)):
    """Return (f, 3) mean log probabilities, shares drawn anew and scales, by degrees of freedom.

    They are of how levels change along lines in the tissue before the needle is in the volumes.
    """
    before = [volume for volume, needle, length in recording if needle is None or length == 0]
    shown, original = [], line_belief.change_between

    def change_between(now, last):
        shown.append((now, last))
        return original(now, last)

    with mock.patch.object(line_belief, "change_between", change_between):
        belief = LineBelief()
        for volume in before:
            belief = follow(belief, volume)
    rows = []
    for tail in map(float, freedoms):
        peak = gamma(0.5 * (tail + 1)) / gamma(0.5 * tail) * np.sqrt(2 / tail)
        with mock.patch.multiple(line_contrast, _TAIL=tail, _PEAK=peak):
            logs, changes = [], []
            for now, last in shown[::2]:
                change = original(now, last)
                both = np.isfinite(now.levels - last)
                nothing = line_contrast._line_and_nothing(now.contrasts[both])[1]
                anew = 0.5 * (1 + np.exp(line_contrast.log_ratio(now.contrasts[both])))
                same = line_contrast.repeat_ratio(now, last, change)[both]
                share = change.renewed
                logs.append(np.log(nothing * (share * anew + (1 - share) * same)))
                changes.append(change)
            rows.append([np.concatenate(logs).mean(), *np.median(changes, axis=0)])
    return np.array(rows)


def main(arguments=None):
    """Study the sequences asked for, and print a table."""
    parser = argparse.ArgumentParser(prog="line_study", description=__doc__)
    parser.add_argument("kinds", nargs="+", choices=list(KINDS))
    parser.add_argument("--seeds", nargs=2, type=int, default=(100, 102))
    parser.add_argument("--tails", action="store_true", help="study changes before a needle comes")
    parser.add_argument("--folder", default="out/line_study", help="where recordings are kept")
    chosen = parser.parse_args(arguments)
    stated = []
    for kind in chosen.kinds:
        for seed in range(*chosen.seeds):
            recording = recorded(kind, seed, chosen.folder)
            if chosen.tails:
                print(kind, seed, *map(str, tails(recording).round(3).tolist()), sep="  ")
                continue
            row, each = study(recording)
            stated += each
            print(kind, seed, *(f"{name} {value:.2f}" for name, value in row.items()), sep="  ")
    if not stated:
        return
    p, right = np.array(stated).T
    for low, high in pairwise(BINS):
        here = (p >= low) & ((p < high) | (high == 1.0))
        if here.any():
            print(f"stated {p[here].mean():.2f}: right {right[here].mean():.2f} of {here.sum()}")


if __name__ == "__main__":
    main()
