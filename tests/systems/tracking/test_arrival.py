"""When a line arrived, against sums over all histories, and what kymographs make of a line."""

from itertools import pairwise, product

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from sonoservo.systems.tracking import arrival
from sonoservo.systems.tracking.arrival import add_volume, advances, class_logs, renewed_shares
from sonoservo.systems.tracking.line_contrast import Change, LineLevels, log_ratio, repeat_ratio

SHOWS, RENEWED, PRIOR = 0.7, 0.03, 0.002


def bernoulli_chain(factors):
    """Log of the sum over all 2^b patterns of there and not there, by their prior."""
    logs = []
    for pattern in product((0, 1), repeat=len(factors)):
        p = arrival._BEGIN if pattern[0] else 1 - arrival._BEGIN
        for a, b in pairwise(pattern):
            change = arrival._END if a else arrival._BEGIN
            p *= change if a != b else 1 - change
        logs.append(np.log(p) + np.log(factors)[np.array(pattern, bool)].sum())
    return logsumexp(logs) if logs else 0.0


def advancing(factors, moves, seen=None):
    """Log of the sum over all paths of a tip, mode and place at each time, and where it surely is.

    They are weighed by their prior. ``moves`` are by time, mode and bins passed. Without the first
    bin that is seen, the tip begins anywhere.
    """
    times, bins = factors.shape
    modes = moves.shape[1]

    def before(a):
        return bernoulli_chain(factors[0, :a]) if a else 0.0

    def beyond(a):
        return bernoulli_chain(factors[0, a:][::-1]) if a < bins else 0.0

    def switch(m, n):
        if m == n:
            return arrival._KEEPS
        leaves = 1 - arrival._KEEPS
        if m == 0:
            return leaves / (modes - 1)
        return 0.6 * leaves if n == 0 else 0.4 * leaves / max(modes - 2, 1)

    logs, ends = [], []
    for places in product(range(bins + 1), repeat=times):
        steps = np.diff(places)
        if (steps < 0).any() or (steps >= moves.shape[2]).any():
            continue
        enters = 0.0 if seen is None else arrival._ENTERING
        first = (1 - enters) / (bins + 1) + enters * (places[0] == seen)
        came = sum(np.log(factors[t, places[t - 1] : places[t]]).sum() for t in range(1, times))
        for path in product(range(modes), repeat=times):
            p = first * (0.5 if path[0] == 0 else 0.5 / (modes - 1))
            for t in range(1, times):
                p *= switch(path[t - 1], path[t]) * moves[t, path[t], steps[t - 1]]
            if p == 0:
                continue
            logs.append(np.log(p) + came + before(places[0]) + beyond(places[-1]))
            ends.append(places[-1])
    total = logsumexp(logs)
    shares = np.bincount(ends, np.exp(logs - total))
    return total, int(np.flatnonzero(np.cumsum(shares) >= arrival._SURE)[0])


def slides(passing):
    """(t, m, d) probabilities that a glint passes d bins, by how far the image does."""
    means = np.multiply.outer(np.maximum(passing, 0.0), arrival.GLINTS)[..., np.newaxis]
    rows = norm.pdf(np.arange(arrival._MOST), means, 0.35 * means + 0.35)
    return rows / rows.sum(axis=-1, keepdims=True)


def test_classes_are_the_sums_over_all_histories():
    bins, times = 4, 3
    rng = np.random.default_rng(3)
    moves = rng.uniform(0.1, 1.0, (times, 3, 3))
    moves /= moves.sum(axis=2, keepdims=True)
    appearing = np.log([1e-20, 0.01, 0.02])
    logs, riding = rng.normal(0.5, 2.0, (2, times, bins)), rng.normal(0.0, 2.0, (2, bins))
    logs[1, 0, 0] = 0.0  # not seen
    passing = np.array([[0.0, 1.0, -0.7], [0.0, 0.0, 0.0]])
    found, passed = class_logs(logs, riding, appearing, moves, passing)
    for n in range(2):
        factors = np.exp(arrival._SHARE * logs[n])
        seen = [int(np.flatnonzero(each != 1)[0]) for each in (factors[0], factors[0, ::-1])]
        at_once = [bernoulli_chain(factors[t]) + appearing[t] for t in range(1, times)]
        one, other = (advancing(factors[:, ::d], moves, seen[d < 0]) for d in (1, -1))
        expected = [
            one[0],
            other[0],
            logsumexp(
                [
                    bernoulli_chain(factors[0]),
                    advancing(factors, slides(passing[n]))[0] - np.log(2),
                    advancing(factors[:, ::-1], slides(-passing[n]))[0] - np.log(2),
                ]
            )
            - np.log(2),
            bernoulli_chain(np.exp(arrival._SHARE * riding[n])),
            logsumexp(at_once),
        ]
        np.testing.assert_allclose(found[n], expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(passed[n], [one[1], other[1]])


def test_a_bin_repeats_itself_or_is_drawn_anew():
    rng = np.random.default_rng(0)
    ratios, repeats = rng.normal(0.0, 1.5, 6), np.exp(rng.normal(0.0, 1.0, 6))
    repeats[0] = np.nan  # nothing was seen before
    logs = np.zeros((1, 6, 1))
    for t in range(6):
        here = np.array([[ratios[t]]]), np.array([[repeats[t]]])
        add_volume(logs[:, : t + 1], *here, np.array([[RENEWED]]), SHOWS)

    def likelihood(arrived):
        """Sum over all histories: anew or the same, shown or hidden whenever drawn."""
        total = 0.0
        for later, shown in product(product((0, 1), repeat=5), product((0, 1), repeat=6)):
            anew, p = (1, *later), 1.0
            for t in range(6):
                if t == arrived > 0:
                    p *= anew[t]
                elif t > 0:
                    p *= RENEWED if anew[t] else 1 - RENEWED
                if not anew[t]:
                    p *= repeats[t] * (not shown[t])  # not drawn: counted once
                elif t >= arrived:
                    p *= SHOWS * np.exp(ratios[t]) if shown[t] else 1 - SHOWS
                else:
                    p *= not shown[t]
            total += p
        return total

    for arrived in (0, 3):
        expected = np.log(likelihood(arrived) / likelihood(6))
        assert logs[0, arrived, 0] == pytest.approx(expected)
    before = logs.copy()
    add_volume(logs, np.array([[np.nan]]), np.array([[1.0]]), np.array([[RENEWED]]), SHOWS)
    np.testing.assert_array_equal(logs, before)


def test_what_is_drawn_anew_goes_on_along_the_line():
    ratios, repeats = np.zeros((2, 6)), np.full((2, 6), 1e3)
    repeats[0, 1:3] = 1e-6  # these are nothing like what was there before
    repeats[1] = 1e-6
    repeats[1, 2] = np.nan  # not seen
    on, off = arrival._CHANGES_ON, RENEWED
    expected = [[off, off, on, on, off, off], [off, on, on, off, on, on]]
    np.testing.assert_allclose(renewed_shares(ratios, repeats, RENEWED), expected, atol=1e-3)


def kymograph(kind, times=16, bins=40):
    """(t, b) contrasts in dB that a line of a kind gives along itself, and those riding."""
    rng = np.random.default_rng(5)
    there = np.zeros((2, times, bins), bool)
    for t in range(times):
        if kind == "needle":
            there[0, t, : max(0, 2 * (t - 5))] = True
        elif kind == "needle the other way":
            there[0, t, bins - max(0, 2 * (t - 5)) :] = True
        elif kind == "resting":
            there[0, t, 8:26] = True
        elif kind == "uncovered":  # as the probe moves along
            there[0, t, 4 : 4 + 2 * t] = True
        elif kind == "riding":  # it sweeps over the line in the tissue, and rests in the image
            there[0, t, 8:26] = t == times - 1
            there[1, t, 8:26] = True
        elif kind == "appeared":
            there[0, t, 8:26] = t > 5
    return np.where(there, 8.0, -1.5) + rng.normal(0.0, 0.7, there.shape)


KINDS = ("needle", "needle the other way", "resting", "riding", "appeared", "nothing")


@pytest.mark.parametrize("kind", [*KINDS, "uncovered"])
def test_a_kymograph_shows_what_a_line_is(kind):
    here, riding = kymograph(kind)
    times, bins = here.shape
    logs, image_logs = np.zeros((1, times + 1, bins)), np.zeros((1, 1, bins))
    before = np.full((2, 1, bins), np.nan)
    renewed = 0.5 if kind in ("riding", "uncovered") else RENEWED  # the probe moves
    for t in range(times):
        # Row 0 stands for always, and row t for what came with the volume t.
        for rows, shown, last in zip(
            (logs[:, : t + 1], image_logs), (here[[t]], riding[[t]]), before, strict=True
        ):
            repeats = repeat_ratio(LineLevels(shown, shown), last, Change(renewed, 1.5))
            shares = renewed_shares(log_ratio(shown), repeats, renewed)
            add_volume(rows, log_ratio(shown), repeats, shares, SHOWS)
            last[:] = shown
    appearing = np.log(np.full(times, PRIOR))
    appearing[0] = -50.0
    passing = np.full((1, times), 2.0 if kind == "uncovered" else 0.0)
    moves = np.array([advances(0.3)] * times)
    classes = class_logs(logs[:, :times], image_logs[:, 0], appearing, moves, passing)[0][0]
    classes = np.append(classes, 0.0)
    assert KINDS[int(classes.argmax())] == kind.replace("uncovered", "resting")
    assert classes.max() > np.sort(classes)[-2] + 0.5
