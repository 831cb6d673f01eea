"""Runs of localization and tracking on the independent volumes, compared with the truth."""

import itertools
import time
from dataclasses import dataclass

import numpy as np
from independent_images import sequence_case, volume_case
from independent_images.cases import draw_kinds
from scipy.stats import chi2

from sonoservo.diagrams.app.volumes.locate import locate_in
from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.diagrams.tracker_bench import TrackerBench
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
    turned = ", turned" if o.turned else ""
    errors = f"along {1e3 * o.along:.1f}, across {1e3 * o.across:.1f} mm"
    return f"{text} {'right' if o.right else 'WRONG'}{turned}, {errors}, {row['confidence']:.2f}"


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
            trackers[start] = TrackerBench(tracker, logged=False)
        made = [
            {"kind": kind, "kinds": kinds, "seed": first_seed + i, "start": start, "outcomes": [],
             "starts": [], "expected": 0, "tracked": 0, "volumes": 0, "ghosts": 0, "moving": False}
            for start in STARTS
        ]  # fmt: skip
        had = dict.fromkeys(STARTS, False)
        path, pose = None, None
        for volume, truth in case:
            pose = pose or volume.X_WP
            if truth is not None and (path is None or len(truth.curve) >= len(path)):
                path = truth.curve
            for row in made:
                estimate = trackers[row["start"]].track(volume)
                note(row, estimate, truth, path, had)
                row["moving"] |= not volume.X_WP.IsNearlyEqualTo(pose, 1e-6)
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
    motion = ", probe moves" if row["moving"] else ""
    return (
        f"sequence {row['seed']} {row['kind']}, {'+'.join(row['kinds']) or 'plain'}, "
        f"{row['start']}{motion}: tracked {row['tracked']} of {row['expected']} expected, "
        f"{row['starts'].count(False)} false starts of {len(row['starts'])}, "
        f"{row['ghosts']} after the end, right {right:.2f}, "
        f"tip median {np.median(tips):.1f}, largest {tips.max():.1f} mm"
    )
