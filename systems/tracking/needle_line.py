"""Search for the line that looks most like a needle, in a volume without a prediction."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.cells import cells_of
from sonoservo.systems.tracking.line_contrast import (
    BIN,
    BINS,
    MIDDLES,
    line_levels,
    log_ratio,
    stretches,
)
from sonoservo.systems.tracking.line_fit import FittedLine, fitted_lines
from sonoservo.systems.tracking.line_looks import line_looks, looks_odds

Floats = NDArray[np.float64]

SHORTEST = 10e-3
"""Smallest visible length of a needle, in m."""

_ALONG, _PARALLEL = 3e-3, math.cos(math.radians(10))
"""Largest mean distance in m of lines that count as one, and smallest cosine of their angle."""


@dataclass(frozen=True, eq=False)
class NeedleLine(Immutable):
    """A line that may be a needle, with (2, 3) ends in P in m, the one at the entry first."""

    ends: Annotated[Floats, Shape(2, 3)]
    probability: float
    """Probability that the needle lies along it, if it is this one or none, by this volume alone.
    """

    @property
    def length(self) -> float:
        """Distance between the ends, in m."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    @property
    def direction(self) -> Floats:
        """(3,) unit vector from the entry's side to the tip, in P."""
        return np.asarray((self.ends[1] - self.ends[0]) / self.length)


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches of lines: (n, 2, 3) ends in P, evidence, and distances from the sides in m."""

    ends: Floats
    evidence: Floats
    entry_gap: Floats
    tip_gap: Floats

    def looks(self, volume: Volume, clutter: float) -> dict[str, Floats]:
        """Return the looks of each; see `line_looks`."""
        return line_looks(
            volume,
            self.ends,
            evidence=self.evidence,
            clutter=clutter,
            entry_gap=self.entry_gap,
            tip_gap=self.tip_gap,
        )


def _frame(ends: Floats) -> tuple[Floats, Floats, Floats]:
    """Return (n, 3) middles and unit vectors, and (n,) lengths of lines with (n, 2, 3) ends."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    return ends.mean(axis=1), along / length[:, np.newaxis], length


def _gaps(seen: NDArray[np.bool_], firsts: NDArray[np.int64], lasts: NDArray[np.int64]) -> Floats:
    """Return (2, n) lengths in m that are seen before the first and beyond the last bins."""
    bins = np.arange(BINS)
    before = np.where(~seen & (bins < firsts[:, np.newaxis]), bins, -1).max(axis=1)
    beyond = np.where(~seen & (bins > lasts[:, np.newaxis]), bins, BINS).min(axis=1)
    return BIN * np.array([firsts - 1 - before, beyond - 1 - lasts], dtype=np.float64)


def lie_along(ends: Floats, others: Floats) -> NDArray[np.bool_]:
    """Return (n, m) flags of the (m, 2, 3) others, by their ends in P, that lie along (n) lines."""
    middles, k, lengths = _frame(ends)
    # (n, m, 9, 3) differences of points of the others and the middles of the lines.
    away = np.linspace(others[:, 0], others[:, 1], 9, axis=1) - middles[:, np.newaxis, np.newaxis]
    reach = 0.5 * lengths[:, np.newaxis, np.newaxis]
    a = np.clip(np.einsum("nmpi,ni->nmp", away, k), -reach, reach)
    away = np.linalg.norm(away - a[..., np.newaxis] * k[:, np.newaxis, np.newaxis], axis=-1)
    return (away.mean(axis=-1) < _ALONG) & (np.abs(k @ _frame(others)[1].T) > _PARALLEL)


def evident_stretches(volume: Volume, ends: Floats) -> Stretches:
    """Return the most evident stretches of lines, the end nearer to the side first."""
    middles, k, _ = _frame(ends)
    contrasts = line_levels(volume, middles, k).contrasts
    firsts, lasts, evidence = stretches(contrasts)
    here = np.flatnonzero(lasts >= firsts)
    firsts, lasts, seen = firsts[here], lasts[here], ~np.isnan(contrasts[here])
    a = np.stack([MIDDLES[firsts] - BIN / 2, MIDDLES[lasts] + BIN / 2], axis=1)
    found = middles[here, np.newaxis] + a[..., np.newaxis] * k[here, np.newaxis]
    before, beyond = _gaps(seen, firsts, lasts)
    found = np.where((beyond < before)[:, np.newaxis, np.newaxis], found[:, ::-1], found)
    return Stretches(found, evidence[here], np.minimum(before, beyond), np.maximum(before, beyond))


@np.errstate(invalid="ignore")
def stretches_between(volume: Volume, ends: Floats) -> tuple[Stretches, NDArray[np.bool_]]:
    """Return the stretches between (n, 2, 3) entries and tips, and flags of those that are seen."""
    middles, k, length = _frame(ends)
    contrasts = line_levels(volume, middles, k).contrasts
    seen = ~np.isnan(contrasts)
    inside = (np.abs(MIDDLES) <= 0.5 * length[:, np.newaxis]) & seen
    firsts, lasts = inside.argmax(axis=1), BINS - 1 - inside[:, ::-1].argmax(axis=1)
    evidence = np.where(inside, log_ratio(contrasts), 0.0).sum(axis=1)
    before, beyond = _gaps(seen, firsts, lasts)
    return Stretches(ends, evidence, before, beyond), inside.sum(axis=1) >= 2


def clutter(fits: Sequence[FittedLine]) -> float:
    """Return the median evidence of the bright lines of a volume; 0 without any."""
    return float(np.median([fit.evidence for fit in fits])) if fits else 0.0


def log_odds(
    volume: Volume, ends: Floats, among: Sequence[FittedLine], *, dark_entry: bool = False
) -> Floats:
    """Return the (n,) log odds that lines in P, entries first, look like needles; NaN if unseen.

    ``among`` are the bright lines of the volume. With ``dark_entry``, a dark part between the side
    of the field of view and the line does not count: the near part of a needle may be faint.
    """
    if len(ends) == 0:
        return np.zeros(0)
    found, seen = stretches_between(volume, ends)
    if dark_entry:
        found = replace(found, entry_gap=np.zeros(len(ends)))
    odds = looks_odds(found.looks(volume, clutter(among)))
    # Each of the bright lines along a needle may be it; see `_needles`.
    fits = np.array([fit.ends for fit in among]).reshape(-1, 2, 3)
    odds += np.log(np.maximum(lie_along(ends, fits).sum(axis=1), 1))
    return np.where(seen, odds, np.nan)


def needle_lines(volume: Volume) -> list[NeedleLine]:
    """Return the lines of a volume that may be needles by their looks, most probable first."""
    fits = fitted_lines(volume, cells_of(volume))
    if not fits:
        return []
    found = evident_stretches(volume, np.array([fit.ends for fit in fits]))
    long = np.linalg.norm(found.ends[:, 1] - found.ends[:, 0], axis=1) >= SHORTEST
    ends, odds = found.ends[long], looks_odds(found.looks(volume, clutter(fits)))[long]
    return _needles(ends, odds)


def _needles(ends: Floats, odds: Floats) -> list[NeedleLine]:
    """Return lines by (n, 2, 3) ends and (n,) log odds, merged, most probable first.

    Probabilities of lines along one needle add up. The one that is itself likely and has the others
    along it stands for all.
    """
    total = logsumexp(np.append(odds, 0.0))
    probabilities, none = np.exp(odds - total), np.exp(-total)
    along = lie_along(ends, ends)
    lines, left = [], np.ones(len(ends), bool)
    while left.any():
        shared = (along & left) @ probabilities
        first = int(np.where(left, probabilities * shared, -1.0).argmax())
        together = float(shared[first] / (shared[first] + none))
        lines.append(NeedleLine(ends[first], together))
        left &= ~(along[first] | along[:, first])
        left[first] = False
    return sorted(lines, key=lambda line: -line.probability)
