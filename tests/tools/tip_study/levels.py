"""Command that fits how a needle's level varies along it, and how it changes up to the tip.

``PYTHONPATH=tests/helpers:tests/tools python -m tip_study.levels --seeds 100 103`` runs needles
that go in, rest, bend and come out. Along each true axis, the search for the end gives a
probability to the 3 mm around the true tip, and keeps a record of the tissue ahead; the table shows
the mean logarithm for several values. In its last column, a bright spot lies 6 mm beyond the place
that each needle reaches.
"""

import argparse
import itertools
from collections import defaultdict
from dataclasses import replace

import numpy as np
from numba import njit
from scipy.special import ndtr

from sonoservo.diagrams import (
    FollowingExperiment,
    FollowingScenario,
    load_scenario,
    require_scenario,
)
from sonoservo.diagrams.experiments.following_scene import observer_events
from sonoservo.diagrams.papers.chatelain2013.reproduction import (
    bent_insertion,
    direction_of_insertion,
)
from sonoservo.systems.recording import VolumeCollector
from sonoservo.systems.signals import NotFound
from sonoservo.systems.signals.tissue_record import TissueRecord
from sonoservo.systems.tracking import tip
from sonoservo.systems.tracking.axis import axis_through

KINDS = {
    "out": ("chatelain2013_fig4", lambda seed: ["duration=60"]),
    "straight": ("chatelain2013_fig5", lambda seed: ["duration=24"]),
    "moved": ("chatelain2013_fig6", lambda seed: []),
    "bent": ("chatelain2013_fig5", lambda seed: [*bent_insertion(seed), "duration=24"]),
    "directions": ("chatelain2013_fig5", direction_of_insertion),
}
"""Scenario and changes by kind of needle."""

VALUES = {"_NOTHING": (1.8, 2.2, 2.6), "_SPREAD": (0.25, 0.33), "_TREND": (3.5e-3, 5e-3, 8e-3),
          "_CHANGES": (0.1, 0.2, 0.4), "_LASTS": (0.0, 0.2, 0.4, 0.6)}  # fmt: skip
PARAMETERS = tip.TipParameters()
NEAR, EVERY, SHORTEST, LEAST = 3e-3, 3, 12e-3, 1e-6
BEYOND, WIDE, BRIGHT = 6e-3, 2.5e-3, 15.0
"""Distance of the spot beyond the tip, its standard deviation in m and its contrast in dB."""


def profiles(scenario, changes, seed):
    """Return profiles along the true axis, with the abscissae of true entry and tip in m."""
    checked = require_scenario(
        load_scenario(scenario, changes=changes, seed=seed), FollowingScenario
    )
    collector = VolumeCollector(**observer_events(checked))
    experiment = FollowingExperiment(checked, observers={"volume_collector": collector})
    experiment.run()
    log, kept = experiment.log(), []
    for volume in collector.volumes(experiment.context_of(collector))[::EVERY]:
        now = int(np.abs(log.time - volume.time).argmin())
        points = log.needle_points[now][[0, 4, 8]]
        if not (
            log.visible_length[now] > 0.01 and np.linalg.norm(points[2] - points[0]) > SHORTEST
        ):
            continue
        axis = axis_through(points)
        entry, end = axis.abscissa(points[[0, 2]])
        found = tip.axis_profile(volume, axis, entry - 0.01, end + 0.05, PARAMETERS)
        if found.seen[np.searchsorted(found.a, end)]:
            kept.append((found, entry, end))
    return kept


def with_spot(sequence):
    """Return a sequence with a bright spot beyond the place that the needle reaches."""
    at = max((end - entry for _, entry, end in sequence), default=0.0) + BEYOND
    for profile, entry, end in sequence:
        spot = BRIGHT * np.exp(-0.5 * ((profile.a - entry - at) / WIDE) ** 2)
        level = np.maximum(profile.level, profile.background + spot)
        yield replace(profile, level=level), entry, end


def log_probabilities(sequence):
    """Yield the logarithms of the probability that the tip lies near the true one."""
    tissue = TissueRecord.unseen(PARAMETERS.step)
    for profile, entry, end in sequence:
        before, looks = tissue.at(profile.a - entry)
        extent = tip.find_extent(replace(profile, before=before, looks=looks), PARAMETERS)
        yield log_probability(extent, end)
        if not isinstance(extent, NotFound):
            tissue = tissue.seen(profile.a - entry, extent.contrast, extent.ahead, extent.as_before)


def log_probability(extent, end):
    """Return the logarithm of the probability that the tip lies near the true one."""
    if isinstance(extent, NotFound):
        return np.log(LEAST)
    first = [extent.seen, 0.0, extent.tip_std]
    shares, away, stds = np.vstack([first, extent.elsewhere]).T
    off = end - extent.tip - away
    near = ndtr((off + NEAR) / stds) - ndtr((off - NEAR) / stds)
    return np.log(max(shares @ near, LEAST))


def main(arguments=None):
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(100, 102), help="first and one more")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    chosen = parser.parse_args(arguments)
    seen = defaultdict(list)
    for kind, seed in itertools.product(chosen.kinds, range(*chosen.seeds)):
        scenario, changes = KINDS[kind]
        seen[kind].append(profiles(scenario, changes(seed), seed))
    sets = {**seen, "spot": [list(with_spot(each)) for kind in seen.values() for each in kind]}
    print(*(name.strip("_").lower() for name in VALUES), *sets, sep=" | ")
    for values in itertools.product(*VALUES.values()):
        for name, value in zip(VALUES, values, strict=True):
            setattr(tip, name, value)
        for kernel in ("_needle_logs", "_tissue_logs", "_end_logs"):
            setattr(tip, kernel, njit(error_model="numpy")(getattr(tip, kernel).py_func))
        means = [np.mean([x for each in kind for x in log_probabilities(each)])
                 for kind in sets.values()]  # fmt: skip
        print(*values, *np.round(means, 3), sep=" | ", flush=True)


if __name__ == "__main__":
    main()
