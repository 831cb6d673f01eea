"""Command that fits how a needle's level varies along it, and how it changes up to the tip.

``PYTHONPATH=tests/helpers:tests/tools python -m tip_study.levels --seeds 100 103`` runs needles
that go in, rest, bend and come out. Along each true axis, the search for the end gives a
probability to the 3 mm around the true tip; the table shows its mean logarithm for several values.
"""

import argparse
import itertools
from collections import defaultdict

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
          "_CHANGES": (0.1, 0.2, 0.4)}  # fmt: skip
PARAMETERS = tip.TipParameters()
NEAR, EVERY, SHORTEST, LEAST = 3e-3, 3, 12e-3, 1e-6


def profiles(scenario, changes, seed):
    """Yield profiles along the true axis, with the abscissa of the true tip in m."""
    checked = require_scenario(
        load_scenario(scenario, changes=changes, seed=seed), FollowingScenario
    )
    collector = VolumeCollector(**observer_events(checked))
    experiment = FollowingExperiment(checked, observers={"volume_collector": collector})
    experiment.run()
    log = experiment.log()
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
            yield found, end


def log_probability(profile, end):
    """Return the logarithm of the probability that the tip lies near the true one."""
    extent = tip.find_extent(profile, PARAMETERS)
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
        seen[kind] += profiles(scenario, changes(seed), seed)
    print(*(name.strip("_").lower() for name in VALUES), *seen, "all", sep=" | ")
    for values in itertools.product(*VALUES.values()):
        for name, value in zip(VALUES, values, strict=True):
            setattr(tip, name, value)
        for kernel in ("_needle_logs", "_tissue_logs", "_end_logs"):
            setattr(tip, kernel, njit(error_model="numpy")(getattr(tip, kernel).py_func))
        means = [np.mean(list(itertools.starmap(log_probability, seen[kind]))) for kind in seen]
        print(*values, *np.round([*means, np.mean(means)], 3), sep=" | ", flush=True)


if __name__ == "__main__":
    main()
