"""Command line of the study."""

import argparse
from dataclasses import dataclass, fields
from itertools import pairwise
from unittest import mock

import numpy as np

from sonoservo.systems.signals.line_hypotheses import LINE_CLASSES
from sonoservo.systems.signals.volume import acquired_from
from sonoservo.systems.tracking import line_belief
from sonoservo.systems.tracking.line_belief import LineBelief, follow
from sonoservo.systems.tracking.line_fit import FittedLine, fitted_lines
from sonoservo.systems.tracking.line_search import HALF_LENGTH, bright_lines

from .sequences import KINDS, recorded

ASIDE, ANGLE_DEG, BEYOND = 3e-3, 10.0, 8e-3
"""Distance and angle within which a line is a needle's, and how far beyond its ends it may lie."""

ACT, CONSPICUOUS = 0.95, 10e-3
"""Probability at which a needle is believed, and length in m from which on it is conspicuous."""

AGE = 4
"""Number of volumes after which it is known whether a new line had appeared at once."""

BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Borders of the stated probabilities that are compared with how often a line is a needle."""


@dataclass
class Row:
    """Figures of one sequence.

    ``visible`` volumes show 10 mm of the needle. ``near`` is the share of them in which a bright
    line lies near the needle, ``fitted`` that in which a fit lies along it, ``rank`` the median
    place of the first such fit, ``followed`` the share in which a line that is followed does, and
    ``believed`` that in which such a line is believed. ``found_s`` counts from the first visible
    volume. ``false`` lines are believed and lie along no needle.
    ``appear`` is how often a new line appeared at once, by volume, relative to how often a bin is
    drawn anew, before the needle is seen.
    """

    kind: str
    seed: int
    volumes: int = 0
    visible: int = 0
    near: float = np.nan
    fitted: float = np.nan
    rank: float = np.nan
    followed: float = np.nan
    believed: float = np.nan
    found_s: float = np.nan
    false: int = 0
    appear: float = np.nan


def is_needle(ends, needle, aside=ASIDE, angle_deg=ANGLE_DEG):
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
    return (away < aside) & (turn > np.cos(np.radians(angle_deg))) & there


def study(kind, seed, recording, *, given=False, say=None):
    """Return the `Row` of a recording, and (n, 2) stated probabilities with what was right.

    With ``given``, the true line is among the fits of each volume.
    """
    row, belief = Row(kind, seed, len(recording.volumes)), LineBelief()
    shares, ranks, false, stated = [], [], set(), []
    begun, born, appeared, renewed = np.inf, {}, [], []
    for volume, needle, length in zip(
        recording.volumes, recording.needles, recording.conspicuous, strict=True
    ):
        visible = needle is not None and length >= CONSPICUOUS
        fits = []

        def fitted(volume, cells, needle=needle, visible=visible, fits=fits):
            fits += fitted_lines(volume, cells)
            return [FittedLine(needle[[0, -1]], 1e3, 1e3), *fits] if given and visible else fits

        with mock.patch.object(line_belief, "fitted_lines", fitted):
            belief = follow(belief, volume)
        lines = belief.hypotheses
        if length == 0:
            renewed.append(belief.memory[-1].change.renewed)
            for number, classes in zip(lines.numbers, lines.classes, strict=True):
                if len(renewed) - born.setdefault(number, len(renewed)) == AGE:
                    share = classes[LINE_CLASSES.index("appeared")]
                    appeared.append(share / (len(belief.memory) - 1))
        ends = acquired_from(volume, lines.ends.reshape(-1, 3)).reshape(-1, 2, 3)
        right, sure = is_needle(ends, needle), lines.probabilities > ACT
        for n in np.flatnonzero(sure & ~right):
            if say and lines.numbers[n] not in false:
                say(
                    f"  {volume.time:5.1f} s: false line {lines.numbers[n]:.0f}, "
                    f"P {lines.probabilities[n]:.2f}, classes {np.round(lines.classes[n], 2)}, "
                    f"looks {lines.looks[n]:.1f}, ends {np.round(1e3 * ends[n]).tolist()} mm"
                )
            false.add(lines.numbers[n])
        if len(ends):
            best = lines.probabilities.argmax()
            stated.append((lines.probabilities[best], right[best]))
        if (sure & right).any() and np.isnan(row.found_s):
            row.found_s = volume.time - min(begun, volume.time)
        if not visible:
            continue
        begun = min(begun, volume.time)
        middles, k = bright_lines(belief.memory[-1].cells, 100)
        here = np.array([-1.0, 1.0])[:, np.newaxis] * HALF_LENGTH * k[:, np.newaxis]
        near = is_needle(middles[:, np.newaxis] + here, needle, 5e-3, 25.0)
        along = np.flatnonzero(
            is_needle(np.array([fit.ends for fit in fits]).reshape(-1, 2, 3), needle)
        )
        shares.append((near.any(), len(along) > 0, right.any(), (sure & right).any()))
        ranks += list(along[:1] + 1)
        if say:
            best = np.flatnonzero(right)
            best = best[lines.probabilities[best].argmax()] if len(best) else None
            say(
                f"  {volume.time:5.1f} s, {1e3 * length:3.0f} mm: near {near.any():d}, "
                f"fit {along[0] + 1 if len(along) else 0}, "
                + (
                    "not followed"
                    if best is None
                    else f"line {lines.numbers[best]:.0f}: P {lines.probabilities[best]:.2f}, "
                    f"classes {np.round(lines.classes[best], 2)}, looks {lines.looks[best]:.1f}"
                )
            )
    if appeared:
        row.appear = np.mean(appeared) / np.median(renewed)
    row.visible, row.false = len(shares), len(false)
    if shares:
        row.near, row.fitted, row.followed, row.believed = np.mean(shares, axis=0)
    if ranks:
        row.rank = np.median(ranks)
    return row, stated


def main(arguments=None):
    """Study the sequences asked for, and print a table."""
    parser = argparse.ArgumentParser(prog="line_study", description=__doc__)
    parser.add_argument("kinds", nargs="+", choices=list(KINDS))
    parser.add_argument("--seeds", nargs=2, type=int, default=(100, 102))
    parser.add_argument("--folder", default="out/line_study", help="where recordings are kept")
    parser.add_argument("--given", action="store_true", help="hand over the true line")
    parser.add_argument("--verbose", action="store_true", help="print a line for each volume")
    chosen = parser.parse_args(arguments)
    print("  ".join(field.name for field in fields(Row)))
    stated = []
    for kind in chosen.kinds:
        for seed in range(*chosen.seeds):
            recording = recorded(kind, seed, chosen.folder)
            say = print if chosen.verbose else None
            row, each = study(kind, seed, recording, given=chosen.given, say=say)
            stated += each
            values = [getattr(row, field.name) for field in fields(Row)]
            print("  ".join(f"{x:.2f}" if isinstance(x, float) else str(x) for x in values))
    p, right = np.array(stated).T
    for low, high in pairwise(BINS):
        here = (p >= low) & ((p < high) | (high == 1.0))
        if here.any():
            print(f"stated {p[here].mean():.2f}: right {right[here].mean():.2f} of {here.sum()}")


if __name__ == "__main__":
    main()
