"""When each bin of a line arrived, and what that makes of the line: needle, at rest, or neither."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.sampling.workers import by_parts
from sonoservo.systems.tracking.line_contrast import BIN

Floats = NDArray[np.float64]

SPEEDS = (0.0, 1e-3, 3e-3, 8e-3, 16e-3, 30e-3)
"""Speeds at which a hand pushes a needle, in m/s; see `advances`."""

GLINTS = (0.0, 1.0, 3.0)
"""Speeds at which the visible part of a smooth line slides along it, relative to the probe's: it
runs ahead where the probe turns, and on a hollow surface."""

_MOST = 16
"""Number of bins that a tip may pass between two volumes."""

_KEEPS = 0.8
"""Probability that a hand goes on as it does from one volume to the next."""

_SHARE = 0.5
"""Share of a bin's evidence that its neighbours do not give as well: a line's echo and the speckle
beside it are longer than a bin."""

_CHANGES_ON = 0.25
"""Probability that a bin is drawn anew if the one before it is: what changes is longer than one."""

_BEGIN, _END = 0.02, 0.04
"""Probabilities that something bright begins and ends from one bin to the next: structures are some
5 cm apart and long."""

_ENTERING = 0.7
"""Probability that a needle is first seen at the outer end of the part of its line in view."""

_SURE = 0.95
"""Probability that the end of a needle has come no further than is called sure."""

_LARGEST = 20.0
"""Largest logarithm of a bin's ratio; more would change nothing."""


@lru_cache(maxsize=2)
def _hand(modes: int) -> tuple[Floats, Floats]:
    """Return (m,) probabilities of a hand's first speed, and (m, m) of the next from each."""
    first = np.full(modes, 0.5 / (modes - 1))
    first[0] = 0.5
    leaves = 1 - _KEEPS
    change = np.full((modes, modes), 0.4 * leaves / max(modes - 2, 1))
    change[:, 0], change[0] = 0.6 * leaves, leaves / (modes - 1)
    np.fill_diagonal(change, _KEEPS)
    return first, change


@njit(cache=True, nogil=True, error_model="numpy")
def _passed(mean: float) -> Any:  # pragma: no cover - compiled
    """Return (`_MOST`,) probabilities of numbers of bins passed, by a mean known to a third."""
    row = np.zeros(_MOST)
    for d in range(_MOST):
        row[d] = math.exp(-0.5 * ((d - mean) / (0.35 * mean + 0.35)) ** 2)
    return row / row.sum()


@lru_cache(maxsize=256)
def _advances(milliseconds: int) -> Floats:
    return np.array([_passed(speed * 1e-3 * milliseconds / BIN) for speed in SPEEDS])


def advances(seconds: float) -> Floats:
    """Return (m, d) probabilities of the number of bins that a tip passes in a time in s.

    There is a row for each of the `SPEEDS`, from which a hand's differs by about a third.
    """
    return _advances(max(round(1e3 * seconds), 1))


@njit(cache=True, nogil=True, error_model="numpy")
def renewed_shares(ratios: Any, repeats: Any, renewed: float) -> Any:  # pragma: no cover - compiled
    """Return (n, b) probabilities that bins are drawn anew, before it is known what they show.

    A bin is more likely to be drawn anew if the one before it along the line was. Arguments as of
    `add_volume`.
    """
    lines, bins = ratios.shape
    result = np.full((lines, bins), renewed)
    for n in range(lines):
        before = 0.0
        for b in range(bins):
            share = renewed + max(_CHANGES_ON - renewed, 0.0) * before
            result[n, b] = share
            anew = share * 0.5 * (1 + math.exp(ratios[n, b]))
            before = anew / (anew + (1 - share) * repeats[n, b])
            if math.isnan(before):
                before = 0.0
    return result


def add_volume(
    logs: Floats,
    ratios: Floats,
    repeats: Floats,
    renewed: Floats,
    prior: float,
) -> None:
    """Add a volume to ``logs``, (n, t, b) log ratios of each bin having arrived at one of t times.

    A bin's echo is drawn anew, or it repeats itself and says nothing new; what arrives with the
    volume is always drawn. ``ratios`` (log), ``repeats`` (density) and ``renewed`` (probability)
    are (n, b), NaN where not seen; ``prior`` is the probability that a bin which is there shows.
    """
    drawn = prior * np.exp(ratios) + 1 - prior
    first = np.isnan(repeats)
    anew, same = np.where(first, 1.0, renewed), np.where(first, 0.0, (1 - renewed) * repeats)
    nothing = anew + same
    arrived, there = np.log(drawn / nothing), np.log((anew * drawn + same) / nothing)
    unseen = np.isnan(arrived)
    arrived[unseen] = there[unseen] = 0
    logs[:, 1:][:, -1:] += arrived[:, np.newaxis]
    logs[:, : max(logs.shape[1] - 1, 1)] += there[:, np.newaxis]


@njit(cache=True, nogil=True, error_model="numpy")
def _stretches(factors: Any) -> Any:  # pragma: no cover - compiled
    """Return (b + 1,) logs of the evidence before each bin for stretches at rest, against none."""
    absent, present = 1 - _BEGIN, _BEGIN
    result = np.zeros(len(factors) + 1)
    for b in range(len(factors)):
        if b > 0:
            absent, present = (
                absent * (1 - _BEGIN) + present * _END, absent * _BEGIN + present * (1 - _END)
            )  # fmt: skip
        present *= factors[b]
        norm = absent + present
        absent /= norm
        present /= norm
        result[b + 1] = result[b] + math.log(norm)
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def _advancing(  # pragma: no cover - compiled
    factors: Any, before: Any, beyond: Any, first: Any, moves: Any, start: Any, change: Any
) -> Any:
    """Return the log of the summed probability of all ends that advance along a line, and a bin.

    The end has now surely come no further than to that bin's beginning.

    ``factors`` are (t, b) likelihood ratios by time of arrival, ``before``, ``beyond`` and
    ``first`` (b + 1,) by place of the end, and ``moves`` (t, m, d) probabilities of d bins at speed
    m.
    """
    times, bins = factors.shape
    modes, most = moves.shape[1:]
    top = before.max()
    tip, mixed = np.zeros((modes, bins + 1)), np.zeros((modes, bins + 1))
    for a in range(bins + 1):
        for m in range(modes):
            tip[m, a] = start[m] * first[a] * math.exp(before[a] - top)
    result = top
    passed = np.zeros(bins + 1)
    for t in range(1, times):
        mixed[:] = 0
        for m in range(modes):
            for n in range(modes):
                for a in range(bins + 1):
                    mixed[n, a] += change[m, n] * tip[m, a]
        # By the number of bins passed, so that the inner loops go along the line.
        tip[:] = 0
        passed[:] = 1
        for d in range(min(most, bins + 1)):
            if d > 0:
                for a in range(bins + 1 - d):
                    passed[a] *= factors[t, a + d - 1]
            for m in range(modes):
                move, come, gone = moves[t, m, d], tip[m, d:], mixed[m]
                if move > 0:
                    for a in range(bins + 1 - d):
                        come[a] += gone[a] * move * passed[a]
        total = tip.sum()
        if total <= 0:
            return -1e3, bins
        tip /= total
        result += math.log(total)
    best = -np.inf
    for a in range(bins + 1):
        here = tip[:, a].sum()
        if here > 0:
            best = max(best, math.log(here) + beyond[a])
    total = 0.0
    for a in range(bins + 1):
        here = tip[:, a].sum()
        if here > 0:
            total += math.exp(math.log(here) + beyond[a] - best)
        passed[a] = total
    return result + best + math.log(total), np.searchsorted(passed, _SURE * total)


@njit(cache=True, nogil=True, error_model="numpy")
def _class_logs(  # pragma: no cover - compiled
    logs: Any, riding: Any, appearing: Any, moves: Any, hand: Any, probe: Any, passing: Any
) -> Any:
    """Return what `class_logs` does; ``hand`` and ``probe`` as `_hand` gives them."""
    count, times, bins = logs.shape
    result, ends = np.full((count, 5), -1e3), np.full((count, 2), bins)
    factors, turned = np.zeros((times, bins)), np.zeros((times, bins))
    first, anywhere = np.zeros(bins + 1), np.full(bins + 1, 1 / (bins + 1))
    shift, rests = np.zeros((times, len(GLINTS), _MOST)), _passed(0.0)
    for n in range(count):
        bound = 0.0
        for b in range(bins):
            highest = 0.0
            for t in range(times):
                highest = max(highest, _SHARE * logs[n, t, b])
            bound += highest
            factors[0, b] = math.exp(min(_SHARE * logs[n, 0, b], _LARGEST))
            turned[0, bins - 1 - b] = factors[0, b]
        before = _stretches(factors[0])
        back = _stretches(turned[0])
        result[n, 2] = before[bins]
        result[n, 3] = _stretches(np.exp(_SHARE * riding[n]))[bins]
        # No needle is more probable than if each bin had arrived at its own best time. One that is
        # less probable than a line at rest needs no probability in full.
        if bound < max(result[n, 2], result[n, 3]):
            result[n, 0] = result[n, 1] = bound
            continue
        for t in range(1, times):
            for b in range(bins):
                factors[t, b] = math.exp(min(_SHARE * logs[n, t, b], _LARGEST))
                turned[t, bins - 1 - b] = factors[t, b]
            one = _stretches(factors[t])[bins] + appearing[t]
            a, c = max(result[n, 4], one), min(result[n, 4], one)
            result[n, 4] = a + math.log1p(math.exp(c - a))
        for way in range(2):
            seen = 0
            one = factors if way == 0 else turned
            for b in range(bins):
                if one[0, b] != 1.0:
                    seen = b
                    break
            first[:] = (1 - _ENTERING) / (bins + 1)
            first[seen] += _ENTERING
            sides = (before, back[::-1]) if way == 0 else (back, before[::-1])
            result[n, way], ends[n, way] = _advancing(one, *sides, first, moves, *hand)
            shift[:] = rests
            for t in range(times):
                slid = passing[n, t] if way == 0 else -passing[n, t]
                if slid > 0:
                    for m in range(len(GLINTS)):
                        shift[t, m] = _passed(GLINTS[m] * slid)
            uncovered = _advancing(one, *sides, anywhere, shift, *probe)[0] - math.log(2)
            a, c = max(result[n, 2], uncovered), min(result[n, 2], uncovered)
            result[n, 2] = a + math.log1p(math.exp(c - a))
        result[n, 2] -= math.log(2)
    return result, ends


def class_logs(
    logs: Floats, riding: Floats, appearing: Floats, moves: Floats, passing: Floats
) -> tuple[Floats, NDArray[np.int64]]:
    """Return (n, 5) log evidence of each line: needle from either end, resting, riding, appeared.

    The second array, (n, 2), counts the bins that a needle from either end has passed at most.

    ``logs`` are as of `add_volume`, ``moves`` (t, m, d) are `advances` before each arrival, and
    ``passing`` (n, t) is the motion of the image along the line in bins.
    """
    # The visible part of a smooth line at rest depends on the angle of the sound: its end rests, or
    # slides like one of the `GLINTS`. Both are as probable.
    hand, probe = _hand(moves.shape[1]), _hand(len(GLINTS))

    def of(part: slice) -> Any:
        return _class_logs(logs[part], riding[part], appearing, moves, hand, probe, passing[part])

    parts = [(np.zeros((0, 5)), np.zeros((0, 2), np.int64)), *by_parts(of, len(logs))]
    evidence, ends = zip(*parts, strict=True)
    return np.concatenate(evidence), np.concatenate(ends)
