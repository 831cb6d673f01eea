"""Verdicts on targets, by figures and their 95 % intervals."""

from collections import Counter
from collections.abc import Collection
from enum import StrEnum
from typing import Literal

from sonoservo.systems.evaluation.intervals import proportion_interval

Side = Literal["at most", "at least"]
"""Side of a target on which a figure must lie."""


class Verdict(StrEnum):
    """Verdicts on a target."""

    MET = "yes"
    NOT_MET = "no"
    UNDECIDED = "undecided"
    """The interval crosses the target: more runs would tell."""
    NOT_MEASURED = "not measured"
    """No run gave the figure: it was not asked for, or none got so far."""


def verdict(
    value: float | None, low: float | None, high: float | None, target: float, wanted: Side
) -> Verdict:
    """Return the verdict on a target."""
    if value is None:
        return Verdict.NOT_MEASURED
    if low is not None and high is not None and low < target < high:
        return Verdict.UNDECIDED
    good = value <= target if wanted == "at most" else value >= target
    return Verdict.MET if good else Verdict.NOT_MET


def can_be_judged(total: int, target: float, wanted: Side) -> bool:
    """Return True if a share of runs can meet a target, and can miss it."""
    possible = set()
    for number in range(total + 1 if total else 0):
        low, high = proportion_interval(number, total)
        share = 100 * number / total
        possible.add(verdict(share, 100 * low, 100 * high, target, wanted))
    return {Verdict.MET, Verdict.NOT_MET} <= possible


def summary_of(verdicts: Collection[Verdict]) -> str:
    """Return how many of the measured targets are met, and what is open, as text."""
    if not verdicts:
        return "no targets"
    counts = Counter(verdicts)
    measured = len(verdicts) - counts[Verdict.NOT_MEASURED]
    said = [f"{counts[Verdict.MET]} of {measured} targets met"]
    open_ones = (Verdict.UNDECIDED, Verdict.NOT_MEASURED)
    return ", ".join([*said, *(f"{counts[each]} {each}" for each in open_ones if counts[each])])
