"""Study of localization and tracking in volumes made independently of the project's renderer.

``PYTHONPATH=tests/helpers:tests/tools python -m independent_study --volumes 60 --sequences 24
--first-seed 100`` prints its table. Tune with seeds from 100 on only; 0 to 99 are for reports.
"""

import argparse
import itertools
from dataclasses import dataclass

import numpy as np
from independent_images import sequence_case, volume_case
from independent_images.cases import draw_kinds
from scipy.stats import chi2

from sonoservo.diagrams import (
    Chatelain2013TrackerParameters,
    MakeNeedleTracker,
    TrackerBench,
    locate_in,
)
from sonoservo.systems.signals import TrackingMode

STARTS = ("search", "anywhere")
RIGHT_DISTANCE, RIGHT_ANGLE = 3e-3, 12.0
"""Largest mean distance in m and angle in degrees of a line found from the needle it shows."""
FALSE_START = 10e-3
"""Distance of a start from the needle, or from its path, beyond which it is false, in m."""
SEEN = 15e-3
"""Visible length from which a needle is expected to be found, in m."""
KINDS = ("no needle", "structures", "faint or steep")


@dataclass
class Outcome:
    """Result for a curve in one volume; errors in m."""

    right: bool
    tip: float
    along: float
    across: float
    tip_seen: bool
    turned: bool
    within_along: bool | None = None
    within_across: bool | None = None


def seen_length(truth):
    """Length over which a needle stands out, in m."""
    return truth.length * float(np.mean(truth.visible)) if truth else 0.0


def compare(truth, curve, covariance=None):
    """Compare a curve, and the covariance of its tip, with the truth."""
    k = truth.tip - truth.curve[len(truth.curve) // 2]
    k /= np.linalg.norm(k)
    error = curve.tip - truth.tip
    along = float(error @ k)
    aside = np.linalg.svd(k[np.newaxis])[2][1:]
    across = aside @ error
    points = curve.position(np.linspace(0.1, 0.9, 9))
    distance = np.linalg.norm(points[:, None] - truth.curve, axis=-1).min(axis=1).mean()
    tilt = np.degrees(np.arccos(min(1.0, abs(curve.direction @ k))))
    tip_seen = bool(truth.visible[-5:-1].mean() >= 0.5)
    outcome = Outcome(
        bool(distance < RIGHT_DISTANCE and tilt < RIGHT_ANGLE),
        float(np.linalg.norm(error)), along, float(np.linalg.norm(across)), tip_seen,
        bool(curve.direction @ k < 0),
    )  # fmt: skip
    if covariance is not None:
        outcome.within_along = bool(along**2 <= chi2.ppf(0.95, 1) * (k @ covariance @ k))
        spread = aside @ covariance @ aside.T
        outcome.within_across = bool(across @ np.linalg.solve(spread, across) <= chi2.ppf(0.95, 2))
    return outcome


def study_volumes(count, first_seed):
    """Locate a needle in volumes with and without one; every other volume has structures."""
    rows = []
    for needle, i in itertools.product((True, False), range(count)):
        rng = np.random.default_rng([first_seed + i, int(needle)])
        kinds = draw_kinds(rng) if i % 2 else ()
        volume, truth = volume_case(rng, needle, kinds)
        found = locate_in(volume, seed=first_seed + i)
        outcome = compare(truth, found.curve) if found and truth else None
        rows.append({"needle": needle, "kinds": kinds, "found": bool(found),
                     "seen": seen_length(truth), "outcome": outcome})  # fmt: skip
    return rows


def draw_sequence(i, seed):
    """Kind and iterator of the i-th sequence."""
    rng = np.random.default_rng([seed, 2])
    kind = KINDS[i % 3]
    kinds = draw_kinds(rng) if kind == "structures" or (kind == "no needle" and i % 2) else ()
    chosen = {}
    if kind == "faint or steep":
        chosen = {"level": rng.uniform(6, 10)} if i % 2 else {"dip": rng.uniform(45, 60)}
    return kind, sequence_case(rng, kind != "no needle", kinds, **chosen)


def study_sequences(count, first_seed):
    """Track through sequences, with both ways in which a tracker first finds a needle."""
    rows = []
    for i in range(count):
        kind, case = draw_sequence(i, first_seed + i)
        trackers, made = {}, []
        for start in STARTS:
            parameters = Chatelain2013TrackerParameters(start=start)
            tracker = MakeNeedleTracker(parameters=parameters, period=1.0, seed=first_seed + i)
            trackers[start] = TrackerBench(tracker, logged=False)
            made.append({"kind": kind, "seed": first_seed + i, "start": start, "outcomes": [],
                         "starts": [], "expected": 0, "tracked": 0, "ghosts": 0,
                         "moving": False, "had": False})  # fmt: skip
        path, pose = None, None
        for volume, truth in case:
            pose = pose or volume.X_WP
            if truth is not None and (path is None or len(truth.curve) >= len(path)):
                path = truth.curve
            for row in made:
                note(row, trackers[row["start"]].track(volume), truth, path)
                row["moving"] |= not volume.X_WP.IsNearlyEqualTo(pose, 1e-6)
        rows += made
    return rows


def note(row, estimate, truth, path):
    """Note what a tracker makes of one volume."""
    tracked = bool(estimate) and estimate.mode == TrackingMode.TRACKING
    expected = seen_length(truth) >= SEEN
    row["expected"] += expected
    row["tracked"] += expected and tracked
    row["ghosts"] += tracked and truth is None
    if estimate and not row["had"]:
        near = np.inf if path is None else np.linalg.norm(path - estimate.curve.tip, axis=1).min()
        row["starts"].append(bool(truth is not None and near < FALSE_START))
    row["had"] = bool(estimate)
    if tracked and truth is not None:
        row["outcomes"].append(compare(truth, estimate.curve, estimate.tip_covariance))


def quantiles(values):
    """Median and 95 % quantile of absolute values in m, as text in mm."""
    if not len(values):
        return "-, -"
    return ", ".join(f"{1e3 * q:.2f}" for q in np.quantile(np.abs(values), [0.5, 0.95]))


def share(flags):
    """Share of flags that are set, as text."""
    flags = list(flags)
    return f"{np.mean(flags):.0%} of {len(flags)}" if flags else "-"


def tips(outcomes):
    """Quantiles of the errors of all tips, and of those that are visible."""
    clear = [o.tip for o in outcomes if o.tip_seen]
    return f"tip {quantiles([o.tip for o in outcomes])} mm, visible tip {quantiles(clear)} mm"


def table_of_volumes(rows):
    """Lines of the table about single volumes."""
    needles = [r for r in rows if r["needle"]]
    groups = {
        "plain": [r for r in needles if not r["kinds"]],
        "structures": [r for r in needles if r["kinds"]],
        f"{1e3 * SEEN:.0f} mm visible": [r for r in needles if r["seen"] >= SEEN],
    }
    for name, group in groups.items():
        right = [r["outcome"] for r in group if r["found"] and r["outcome"].right]
        yield (
            f"needle, {name:14} found {len(right)} of {len(group)}, "
            f"wrong {sum(r['found'] for r in group) - len(right)}, "
            f"turned {sum(o.turned for o in right)}; {tips(right)}; "
            f"along {quantiles([o.along for o in right])}, "
            f"across {quantiles([o.across for o in right])} mm"
        )
    for name, chosen in (("plain", False), ("structures", True)):
        group = [r for r in rows if not r["needle"] and bool(r["kinds"]) == chosen]
        yield f"no needle, {name:11} false {sum(r['found'] for r in group)} of {len(group)}"


def table_of_sequences(rows):
    """Lines of the table about sequences."""
    # The start "search" waits for an insertion seen by a probe at rest.
    for start, kind in itertools.product(STARTS, (*KINDS, "probe at rest", "all")):
        rest = {"probe at rest": (False,)}.get(kind, (False, True))
        group = [r for r in rows if r["start"] == start and r["moving"] in rest]
        group = [r for r in group if r["kind"] == kind or kind not in KINDS]
        needles = [r for r in group if r["kind"] != "no needle"]
        outcomes = [o for r in needles for o in r["outcomes"]]
        expected, tracked = (sum(r[name] for r in needles) for name in ("expected", "tracked"))
        found = share(any(o.right for o in r["outcomes"]) for r in needles if r["expected"])
        yield (
            f"{start:8} {kind:15} found {found}, tracked {tracked} of {expected} volumes, "
            f"right {share(o.right for o in outcomes)}, "
            f"turned {share(o.turned for o in outcomes)}; false starts "
            f"{sum(r['starts'].count(False) for r in group)} in {len(group)} sequences, tracked "
            f"without needle {sum(r['ghosts'] for r in group)}; {tips(outcomes)}; in stated 95 %: "
            f"along {share(o.within_along for o in outcomes)}, "
            f"across {share(o.within_across for o in outcomes)}"
        )


def main(arguments=None):
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--volumes", type=int, default=60, help="volumes with, and without needle")
    parser.add_argument("--sequences", type=int, default=24)
    parser.add_argument("--first-seed", type=int, default=100)
    chosen = parser.parse_args(arguments)
    if chosen.volumes:
        print(*table_of_volumes(study_volumes(chosen.volumes, chosen.first_seed)), sep="\n")
    if chosen.sequences:
        print(*table_of_sequences(study_sequences(chosen.sequences, chosen.first_seed)), sep="\n")


if __name__ == "__main__":
    main()
