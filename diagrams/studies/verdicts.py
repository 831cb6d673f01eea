"""Verdicts on targets, by figures and their 95 % intervals."""

from collections.abc import Collection
from enum import StrEnum
from typing import Literal

from sonoservo.systems.evaluation.statistics.intervals import proportion_interval

Side = Literal["at most", "at least"]
"""Side of a target on which a figure must lie."""


class Verdict(StrEnum):
    """Verdicts on a target."""

    MET = "yes"
    NOT_MET = "no"
    UNDECIDED = "undecided"
    """The interval crosses the target: more runs would tell."""


def verdict(
    value: float | None, low: float | None, high: float | None, target: float, wanted: Side
) -> Verdict:
    """Return the verdict on a target.

    Parameters
    ----------
    value
        Figure; None if there is none, which misses every target.
    low, high
        Ends of its interval; None if there is none, and the figure alone decides.
    target, wanted
        Target, and the side of it on which the figure must lie.
    """
    if value is None:
        return Verdict.NOT_MET
    if low is not None and high is not None and low < target < high:
        return Verdict.UNDECIDED
    good = value <= target if wanted == "at most" else value >= target
    return Verdict.MET if good else Verdict.NOT_MET


def can_be_judged(total: int, target: float, wanted: Side) -> bool:
    """Return True if a share of runs can meet a target, and can miss it.

    Parameters
    ----------
    total
        Number of runs.
    target, wanted
        Target of the share in %, and the side of it on which the share must lie.
    """
    possible = set()
    for number in range(total + 1 if total else 0):
        low, high = proportion_interval(number, total)
        share = 100 * number / total
        possible.add(verdict(share, 100 * low, 100 * high, target, wanted))
    return {Verdict.MET, Verdict.NOT_MET} <= possible


def summary_of(verdicts: Collection[Verdict]) -> str:
    """Return how many targets are met, and how many are undecided, as text."""
    if not verdicts:
        return "no targets"
    met, undecided = (
        sum(each is kind for each in verdicts) for kind in (Verdict.MET, Verdict.UNDECIDED)
    )
    return f"{met} of {len(verdicts)} targets met" + (f", {undecided} undecided" * bool(undecided))
