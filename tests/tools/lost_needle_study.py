"""Study of needles that were lost: which lines are taken for them, by how much they have moved.

``PYTHONPATH=tests/helpers:tests/tools python -m lost_needle_study --seeds 100 112``
makes withdrawals in the closed loop and sequences of some of the benchmark's suites, tracks them,
and collects the lines that were looked at while a needle was lost. It prints, for several values of
``_UNMOVED``, in how many volumes the needle would be found again. It is for tuning: seeds from 100
on.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple
from unittest import mock

import numpy as np
from scipy.special import expit

from sonoservo.diagrams.benchmark.entrants import start_tracker
from sonoservo.diagrams.benchmark.sequence import acquire_sequence, load_suites
from sonoservo.diagrams.studies.robustness import reproduction, runs
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.tracking import search_region
from sonoservo.systems.tracking.track_lifecycle import TrackLifecycle
from sonoservo.systems.tracking.track_parameters import TrackParameters

SUITES = ("moved phantom", "structures", "drag", "bent", "faint", "clinic")

ASIDE, ANGLE_DEG, BEYOND, IN_VIEW = 5e-3, 15.0, 6e-3, 5e-3
"""Distance and angle within which a line is the needle's, how far beyond its tip it may end, and
how much of the needle is in view, in m."""

SHARES = (1.0, 1 / 3, 1 / 4, 1 / 6, 1 / 8, 1 / 10)
SURE = 0.95


class Candidate(NamedTuple):
    """A line in a volume without the lost needle, and whether it is that needle."""

    recording: str
    volume: int
    looks: float
    ends: np.ndarray
    last: object
    right: bool


def withdrawal(seed):
    """Return the volumes, the log of the truth and the tracker's seed of a closed loop."""
    settings = reproduction._more(
        reproduction._dial("plain", 0.0), reproduction.withdrawal(seed), loop="closed"
    )
    with runs.scenario_of(reproduction._with(settings, "chatelain2013"), seed) as scenario:
        log, volumes = runs._run_closed_loop(scenario)
    return volumes, log, seed


def recorded(job):
    """Return the volumes, the log of the truth and the tracker's seed of a job (suite, seed)."""
    suite, seed = job
    if suite == "withdrawal":
        return withdrawal(seed)
    sequence = acquire_sequence(load_suites()[suite].settings(), seed)
    return sequence.volumes, sequence.truth, sequence.tracker_seed


def is_needle(ends, truth, time):
    """Return True if a line with (2, 3) ends in W lies along the true needle, if enough shows."""
    now = int(np.abs(truth.time - time).argmin())
    points = truth.needle_points[now]
    if not (np.isfinite(points).all() and truth.visible_length[now] > IN_VIEW):
        return False
    u = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
    k = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    off = ends - points[0]
    aside = np.linalg.norm(off - np.outer(off @ u, u), axis=1).max()
    beyond = ((ends - points[-1]) @ u).max()
    return aside < ASIDE and abs(k @ u) > np.cos(np.radians(ANGLE_DEG)) and beyond < BEYOND


def candidates(job):
    """Return the lines that the tracker looked at while it sought a needle that it had lost."""
    volumes, truth, seed = recorded(job)
    step, found, now = start_tracker({"kind": "chatelain2013"}, seed), {}, {}
    choose, least = TrackLifecycle.most_probable, TrackParameters().volumes_to_follow

    def spy(self, track, lines):
        if track.state is not None and not isinstance(lines, NotFound):
            found[now["number"]] = [
                Candidate(
                    f"{job[0]} {job[1]}", now["number"], float(lines.looks[n]), lines.ends[n],
                    track.state.curve, bool(is_needle(lines.ends[n], truth, now["time"])),
                )
                for n in np.flatnonzero(lines.looked >= least)
            ]  # fmt: skip
        return choose(self, track, lines)

    with mock.patch.object(TrackLifecycle, "most_probable", spy):
        for number, volume in enumerate(volumes):
            now |= {"number": number, "time": volume.time}
            step(volume)
    return [each for volume in found.values() for each in volume]


def row(share, lines):
    """Return a row of the table: what would be found with a value of ``_UNMOVED``."""
    best, loss, right = {}, 0.0, set()
    weight = {each.recording: 0 for each in lines}
    for each in lines:
        weight[each.recording] += 1
    with mock.patch.object(search_region, "_UNMOVED", share):
        for each in lines:
            p = float(expit(search_region.found_again(each.looks, each.ends, each.last)[0]))
            volume = each.recording, each.volume
            best[volume] = max(best.get(volume, (0.0, False)), (p, each.right))
            right |= {volume} if each.right else set()
            loss -= np.log((p if each.right else 1 - p) + 1e-12) / weight[each.recording]
    counts = [
        sum(p > level and needle == wanted for p, needle in best.values())
        for wanted in (True, False)
        for level in (0.5, SURE)
    ]
    return [f"1/{1 / share:g}", len(best), len(right), *counts, f"{loss:.2f}"]


def main():
    parser = argparse.ArgumentParser(prog="lost_needle_study", description=__doc__)
    parser.add_argument("--seeds", nargs=2, type=int, default=(100, 112), metavar=("FIRST", "END"))
    parser.add_argument("--suites", nargs="+", default=["withdrawal", *SUITES])
    chosen = parser.parse_args()
    jobs = [(suite, seed) for seed in range(*chosen.seeds) for suite in chosen.suites]
    with ProcessPoolExecutor(2) as pool:
        lines = [each for found in pool.map(candidates, jobs) for each in found]
    print("_UNMOVED, volumes, with the needle, found, of these surely, false, surely, log loss")
    for share in SHARES:
        print(*row(share, lines), sep="\t")


if __name__ == "__main__":
    main()
