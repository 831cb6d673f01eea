"""Study of localization and tracking in volumes made independently of the project's renderer.

Run ``python -m independent_study --volumes 60 --sequences 24 --first-seed 100`` for its table. Tune
with seeds from 100 on only; seeds 0 to 99 are for reports.
"""

import argparse
import itertools
import time
from dataclasses import dataclass

import numpy as np
from independent_images import sequence_case, volume_case
from independent_images.cases import draw_kinds
from scipy.stats import chi2

from sonoservo.diagrams.app.volumes.locate import locate_in
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker, track_volume
from sonoservo.diagrams.trackers.chatelain2013 import Chatelain2013TrackerParameters
from sonoservo.systems.signals.needle_estimate import TrackingMode

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
    )  # fmt: skip
    if covariance is not None:
        outcome.within_along = bool(along**2 <= chi2.ppf(0.95, 1) * (k @ covariance @ k))
        spread = aside @ covariance @ aside.T
        outcome.within_across = bool(across @ np.linalg.solve(spread, across) <= chi2.ppf(0.95, 2))
    return outcome


def study_volumes(count, first_seed, say=None):
    """Locate a needle in volumes with and without one; every other volume has structures."""
    rows = []
    for needle, i in itertools.product((True, False), range(count)):
        rng = np.random.default_rng([first_seed + i, int(needle)])
        kinds = draw_kinds(rng) if i % 2 else ()
        volume, truth = volume_case(rng, needle, kinds)
        begin = time.perf_counter()
        found = locate_in(volume, seed=first_seed + i)
        row = {"needle": needle, "kinds": kinds, "seed": first_seed + i, "found": bool(found),
               "seen": seen_length(truth), "s": time.perf_counter() - begin}  # fmt: skip
        if found:
            row["confidence"] = found.confidence
            row["outcome"] = compare(truth, found.curve) if truth else None
        else:
            row["reason"] = found.reason
        rows.append(row)
        if say:
            say(describe(row, truth))
    return rows


def describe(row, truth):
    """Return a line about one volume."""
    text = f"volume {row['seed']} needle={row['needle']:d} {'+'.join(row['kinds']) or 'plain'}:"
    if truth:
        text += f" seen {1e3 * row['seen']:.0f} mm {np.median(truth.contrast):.0f} dB,"
    if not row["found"]:
        return f"{text} {row['reason']}"
    if row["outcome"] is None:
        return f"{text} FALSE, confidence {row['confidence']:.2f}"
    o = row["outcome"]
    errors = f"along {1e3 * o.along:.1f}, across {1e3 * o.across:.1f} mm"
    return f"{text} {'right' if o.right else 'WRONG'}, {errors}, {row['confidence']:.2f}"


def draw_sequence(i, seed):
    """Kind and iterator of the i-th sequence."""
    rng = np.random.default_rng([seed, 2])
    kind = KINDS[i % 3]
    kinds = draw_kinds(rng) if kind == "structures" or (kind == "no needle" and i % 2) else ()
    chosen = {}
    if kind == "faint or steep":
        chosen = {"level": rng.uniform(6, 10)} if i % 2 else {"dip": rng.uniform(45, 60)}
    return kind, kinds, sequence_case(rng, kind != "no needle", kinds, **chosen)


def study_sequences(count, first_seed, say=None):
    """Track through sequences, with both ways in which a tracker first finds a needle."""
    rows = []
    for i in range(count):
        kind, kinds, case = draw_sequence(i, first_seed + i)
        trackers = {}
        for start in STARTS:
            parameters = Chatelain2013TrackerParameters(start=start)
            tracker = MakeNeedleTracker(parameters=parameters, period=1.0, seed=first_seed + i)
            trackers[start] = tracker, tracker.CreateDefaultContext()
        made = [
            {"kind": kind, "kinds": kinds, "seed": first_seed + i, "start": start, "outcomes": [],
             "starts": [], "expected": 0, "tracked": 0, "volumes": 0, "ghosts": 0}
            for start in STARTS
        ]  # fmt: skip
        had = dict.fromkeys(STARTS, False)
        path = None
        for volume, truth in case:
            if truth is not None and (path is None or len(truth.curve) >= len(path)):
                path = truth.curve
            for row in made:
                estimate = track_volume(*trackers[row["start"]], volume)
                note(row, estimate, truth, path, had)
        rows += made
        if say:
            for row in made:
                say(describe_sequence(row))
    return rows


def note(row, estimate, truth, path, had):
    """Note what a tracker makes of one volume."""
    tracked = bool(estimate) and estimate.mode == TrackingMode.TRACKING
    expected = seen_length(truth) >= SEEN
    row["volumes"] += 1
    row["expected"] += expected
    row["tracked"] += expected and tracked
    row["ghosts"] += tracked and truth is None
    if estimate and not had[row["start"]]:
        near = np.inf if path is None else np.linalg.norm(path - estimate.curve.tip, axis=1).min()
        row["starts"].append(bool(truth is not None and near < FALSE_START))
    had[row["start"]] = bool(estimate)
    if tracked and truth is not None:
        row["outcomes"].append(compare(truth, estimate.curve, estimate.tip_covariance))


def describe_sequence(row):
    """Return a line about one sequence."""
    tips = 1e3 * np.array([o.tip for o in row["outcomes"]] or [np.nan])
    right = np.mean([o.right for o in row["outcomes"]] or [np.nan])
    return (
        f"sequence {row['seed']} {row['kind']}, {'+'.join(row['kinds']) or 'plain'}, "
        f"{row['start']}: tracked {row['tracked']} of {row['expected']} expected, "
        f"{row['starts'].count(False)} false starts of {len(row['starts'])}, "
        f"{row['ghosts']} after the end, right {right:.2f}, "
        f"tip median {np.median(tips):.1f}, largest {tips.max():.1f} mm"
    )


def quantiles(values):
    """Median and 95 % quantile of absolute values in m, as text in mm."""
    if not len(values):
        return "-, -"
    return ", ".join(f"{1e3 * q:.2f}" for q in np.quantile(np.abs(values), [0.5, 0.95]))


def share(flags):
    """Share of flags that are set, as text."""
    flags = list(flags)
    return f"{np.mean(flags):.0%} of {len(flags)}" if flags else "-"


def table_of_volumes(rows):
    """Lines of the table about single volumes."""
    lines = []
    groups = {
        "needle, plain": [r for r in rows if r["needle"] and not r["kinds"]],
        "needle, structures": [r for r in rows if r["needle"] and r["kinds"]],
        "needle, all": [r for r in rows if r["needle"]],
        f"needle, {1e3 * SEEN:.0f} mm visible": [r for r in rows if r["seen"] >= SEEN],
    }
    for name, group in groups.items():
        found = [r for r in group if r["found"]]
        right = [r["outcome"] for r in found if r["outcome"].right]
        wrong = len(found) - len(right)
        tips = [o.tip for o in right]
        clear = [o.tip for o in right if o.tip_seen]
        confidence = [r["confidence"] for r in found if r["outcome"].right]
        lines.append(
            f"{name:26} found {share(bool(r.get('outcome')) and r['outcome'].right for r in group)}"
            f", wrong {wrong}; tip {quantiles(tips)} mm, visible tip {quantiles(clear)} mm; along "
            f"{quantiles([o.along for o in right])}, across "
            f"{quantiles([o.across for o in right])} mm; confidence "
            f"{np.median(confidence or [np.nan]):.2f}"
        )
    for name, chosen in (("no needle, plain", False), ("no needle, structures", True)):
        group = [r for r in rows if not r["needle"] and bool(r["kinds"]) == chosen]
        false = [r["confidence"] for r in group if r["found"]]
        lines.append(
            f"{name:26} false {len(false)} of {len(group)}; confidence "
            f"{', '.join(f'{each:.2f}' for each in sorted(false)) or '-'}"
        )
    lines.append(f"locate: median {1e3 * np.median([r['s'] for r in rows]):.0f} ms")
    return lines


def table_of_sequences(rows):
    """Lines of the table about sequences."""
    lines = []
    for start, kind in itertools.product(STARTS, (*KINDS, None)):
        group = [r for r in rows if r["start"] == start and kind in (r["kind"], None)]
        needles = [r for r in group if r["kind"] != "no needle"]
        outcomes = [o for r in needles for o in r["outcomes"]]
        expected, tracked = (sum(r[name] for r in needles) for name in ("expected", "tracked"))
        found = share(any(o.right for o in r["outcomes"]) for r in needles if r["expected"])
        false = sum(r["starts"].count(False) for r in group)
        ghosts = sum(r["ghosts"] for r in group)
        clear = [o.tip for o in outcomes if o.tip_seen]
        lines.append(
            f"{start:8} {kind or 'all':15} found {found}, tracked {tracked} of {expected} volumes, "
            f"right {share(o.right for o in outcomes)}; false starts {false} in {len(group)} "
            f"sequences, tracked without needle {ghosts}; tip "
            f"{quantiles([o.tip for o in outcomes])} mm, visible tip {quantiles(clear)} mm; "
            f"in stated 95 %: along {share(o.within_along for o in outcomes)}, across "
            f"{share(o.within_across for o in outcomes)}"
        )
    return lines


def main(arguments=None):
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--volumes", type=int, default=60, help="volumes with, and without needle")
    parser.add_argument("--sequences", type=int, default=24)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--verbose", action="store_true", help="print a line for each case")
    chosen = parser.parse_args(arguments)

    def say(line):
        print(line, flush=True)

    detail = say if chosen.verbose else None
    if chosen.volumes:
        for line in table_of_volumes(study_volumes(chosen.volumes, chosen.first_seed, detail)):
            say(line)
    if chosen.sequences:
        for line in table_of_sequences(
            study_sequences(chosen.sequences, chosen.first_seed, detail)
        ):
            say(line)


if __name__ == "__main__":
    main()
