"""Command line of the study."""

import argparse
from dataclasses import astuple, dataclass, fields

import numpy as np

from sonoservo.diagrams.benchmark.sequence import acquire_sequence, load_suites
from sonoservo.diagrams.studies.robustness.runs import at_times, conspicuous_lengths, in_frame
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.tracking.line_belief import LineBelief, follow
from sonoservo.systems.tracking.line_fit import fitted_lines

ASIDE, ANGLE_DEG, BEYOND = 3e-3, 10.0, 8e-3
"""Distance and angle within which a line is a needle's, and how far beyond its ends it may lie."""

ACT, CONSPICUOUS = 0.95, 10e-3
"""Probability at which a needle is believed, and length in m from which on it is conspicuous."""


@dataclass
class Row:
    """Figures of one sequence."""

    suite: str
    seed: int
    volumes: int = 0
    conspicuous: int = 0
    proposed: float = np.nan
    rank: float = np.nan
    believed: float = np.nan
    found_s: float = np.nan
    false: int = 0


def is_needle(ends, needle):
    """Return (n,) flags of (n, 2, 3) lines in P that lie along a needle, (m, 3) points in P."""
    k = needle[-1] - needle[0]
    length = np.linalg.norm(k)
    k = k / length
    middle, along = ends.mean(axis=1) - needle[0], ends[:, 1] - ends[:, 0]
    a = middle @ k
    aside = np.linalg.norm(middle - np.outer(a, k), axis=1)
    turn = np.abs(along @ k) / np.linalg.norm(along, axis=1)
    there = (a > -BEYOND) & (a < length + BEYOND)
    return (aside < ASIDE) & (turn > np.cos(np.radians(ANGLE_DEG))) & there


def study(suite, seed):
    """Return the `Row` of a sequence of a suite."""
    sequence = acquire_sequence(load_suites([suite])[suite].settings(), seed)
    log, times = sequence.truth, np.array([volume.time for volume in sequence.volumes])
    poses, points = at_times(log, log.X_WP, times), at_times(log, log.needle_points, times)
    lengths = conspicuous_lengths(log, sequence.volumes)
    row, belief = Row(suite, seed, len(times)), LineBelief()
    proposed, ranks, believed, false = [], [], [], set()
    begun = np.inf
    for n, volume in enumerate(sequence.volumes):
        belief = follow(belief, volume)
        lines = belief.hypotheses
        needle = None
        if np.isfinite(points[n]).all():
            X = np.broadcast_to(poses[n], (len(points[n]), 4, 4))
            needle = acquired_from(volume, volume.X_WP.multiply(in_frame(X, points[n]).T).T)
        sure = lines.probabilities > ACT
        ends = acquired_from(volume, lines.ends.reshape(-1, 3)).reshape(-1, 2, 3)
        right = np.zeros(len(ends), bool) if needle is None else is_needle(ends, needle)
        false |= set(lines.numbers[sure & ~right])
        if (sure & right).any() and np.isnan(row.found_s):
            row.found_s = volume.time - min(begun, volume.time)
        if needle is None or lengths[n] < CONSPICUOUS:
            continue
        begun = min(begun, volume.time)
        fits = np.array([fit.ends for fit in fitted_lines(volume, belief.memory[-1].cells)])
        here = np.flatnonzero(is_needle(fits.reshape(-1, 2, 3), needle))
        proposed.append(len(here) > 0)
        ranks += list(here[:1] + 1)
        believed.append(bool((sure & right).any()))
    row.conspicuous, row.false = len(proposed), len(false)
    if proposed:
        row.proposed, row.believed = np.mean(proposed), np.mean(believed)
    if ranks:
        row.rank = np.median(ranks)
    return row


def main(arguments=None):
    """Study the sequences asked for, and print a table."""
    parser = argparse.ArgumentParser(prog="line_study", description=__doc__)
    parser.add_argument("suites", nargs="+", choices=list(load_suites()))
    parser.add_argument("--seeds", nargs=2, type=int, default=(100, 102))
    chosen = parser.parse_args(arguments)
    print("  ".join(field.name for field in fields(Row)))
    for suite in chosen.suites:
        for seed in range(*chosen.seeds):
            values = astuple(study(suite, seed))
            print("  ".join(f"{x:.2f}" if isinstance(x, float) else str(x) for x in values))


if __name__ == "__main__":
    main()
