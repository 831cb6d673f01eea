"""Search for the line that looks most like a needle, in a volume without a prediction."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import expit

from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.cells import cells_of
from sonoservo.systems.tracking.line_features import line_features
from sonoservo.systems.tracking.line_fit import fitted_lines
from sonoservo.systems.tracking.line_profile import profile
from sonoservo.systems.tracking.needle_blur import streak_length
from sonoservo.systems.tracking.tip import most_evident_stretch

Floats = NDArray[np.float64]

_WEIGHTS = {
    "constant": 12.87,
    "evidence": 3.69,
    "short": -6.14,
    "fall": 4.12,
    "entry gap": -1.84,
    "tip at edge": -3.24,
    "width": -7.84,
    "near aside": 0.47,
    "near least": 0.21,
    "far above": -0.17,
    "far middle": -0.74,
    "behind": -0.78,
    "border": -0.49,
}
"""Weights of a line's features (`line_features`) in the logarithm of the odds that it is a needle.

They are a logistic regression on the lines of 1240 volumes from two independent generators of
images, half of them without a needle. Most have bones, fasciae, vessels, calcifications or gas. To
these were added the needles of 65 volumes of the harder world, and 50 volumes without a needle from
a lens that is out of focus.
"""

_SHORTEST, _FARTHEST, _STEEPEST = 10e-3, 8e-3, 0.9
"""Smallest visible length of a needle and largest distance of its entry from the side of the field
of view, in m, and largest share of the depth's direction in its own."""

_STREAKS = 3.0
"""Smallest length of a needle as a multiple of the length to which the beam draws out a point. Far
from the lens's focus, a single scatterer looks like a short needle across the frames."""

_BESIDE, _UNSEEN, _BORDER_SHARE = 3e-3, 0.4, 0.6
"""Distance in m at which more than a share of a point's surroundings are unseen if it lies at the
border of the field of view, and share of such points from which on a line runs along that border.
Within 1.1 mm of a flat side, 44 % are unseen, and more where two sides meet."""

_STEP = 0.5e-3
"""Distance between samples along a line, in m."""

_ANGLES = np.pi / 8 * np.arange(16)
_CIRCLE = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_CORE = np.concatenate([np.zeros((1, 2)), 0.6e-3 * _CIRCLE[::4]])
_RING = np.stack([4e-3 * _CIRCLE, 5.5e-3 * _CIRCLE])
"""Points of a cross-section that show the needle, and points of sixteen sectors beside it, in m."""

_HALF, _BRIGHTER = 8, 0.1
"""Number of samples to either side over which a sector's level is averaged, and share of the
sectors that are brighter than the one with which the line is compared."""

_PART, _PARALLEL, _SHORTER = 2e-3, math.cos(math.radians(10)), 0.8
"""Largest distance of a line's ends from another of which it is a part, in m, smallest cosine of
the angle between the two, and largest share of the other's length."""

_CONTRAST = 3.0
"""Contrast that is evidence neither for nor against a needle, in dB."""

_MAX_EVIDENCE = 6.0
"""Largest evidence of one sample along a line, in dB."""


@dataclass(frozen=True, eq=False)
class NeedleLine(Immutable):
    """A straight stretch that looks like a needle.

    Parameters
    ----------
    ends
        (2, 3) ends in P, in m: the one on the entry's side, and the tip.
    evidence
        Integral along the stretch of the evidence for a needle, in dB m. Samples count that are
        brighter than their surroundings on all sides but one.
    entry_gap, tip_gap
        Distances from the sides of the field of view to the first end and to the tip, in m.
    log_odds
        Logarithm of the odds that the line, or the surest part of it, is a needle, judged by this
        volume alone; -inf if it cannot be one.
    """

    ends: Floats
    evidence: float
    entry_gap: float
    tip_gap: float
    log_odds: float = -math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", read_only(self.ends, "ends", (2, 3)))

    @property
    def length(self) -> float:
        """Distance between the ends, in m."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    @property
    def direction(self) -> Floats:
        """(3,) unit vector from the entry's side to the tip, in P."""
        return np.asarray((self.ends[1] - self.ends[0]) / self.length)

    @property
    def probability(self) -> float:
        """Probability that the line is a needle."""
        return float(expit(self.log_odds))


def _across(ends: Floats) -> tuple[Floats, Floats]:
    """Return the (3,) unit vector along a line and (2, 3) two across it, the first one level."""
    x, y, z = (ends[1] - ends[0]).tolist()
    length, flat = math.hypot(x, y, z), math.hypot(x, z)
    x, y, z = x / length, y / length, z / length
    u, w = (z * length / flat, -x * length / flat) if flat > 1e-6 * length else (1.0, 0.0)
    return np.array([x, y, z]), np.array([[u, 0.0, w], [-y * w, x * w - z * u, y * u]])


def judged(volume: Volume, line: NeedleLine) -> NeedleLine:
    """Return a line with the logarithm of the odds that it is a needle."""
    if (
        line.length < _SHORTEST
        or line.entry_gap > _FARTHEST
        or abs(line.direction[1]) > _STEEPEST
        or line.length < _STREAKS * streak_length(volume, line.ends)
        or _is_border(volume, line.ends)
    ):  # fmt: skip
        return replace(line, log_odds=-math.inf)
    features = line_features(
        volume,
        line.ends,
        evidence=line.evidence,
        entry_gap=line.entry_gap,
        tip_gap=line.tip_gap,
    )
    return replace(line, log_odds=sum(w * features[name] for name, w in _WEIGHTS.items()))


def _is_border(volume: Volume, ends: Floats) -> bool:
    """Return True if a line runs along the border of the field of view."""
    _, across = _across(ends)
    points = np.linspace(ends[0], ends[1], 16)[:, np.newaxis]
    unseen = ~volume.sees(points + _BESIDE * _CIRCLE @ across)
    return bool(np.mean(unseen.mean(axis=1) > _UNSEEN) >= _BORDER_SHARE)


def most_evident_line(volume: Volume, ends: Floats) -> NeedleLine | None:
    """Return the stretch of a line, (2, 3) ends in P, in m, that looks most like a needle."""
    points, contrast, seen = _contrast_along(volume, ends)
    first, last, evidence = most_evident_stretch(
        contrast, seen, step=_STEP, neutral=_CONTRAST, max_evidence=_MAX_EVIDENCE
    )
    if last - first < 8:
        return None
    before, beyond = _gaps(seen, first, last)
    stretch = points[[first, last]]
    if beyond < before:
        stretch, before, beyond = stretch[::-1], beyond, before
    return NeedleLine(stretch, evidence, before, beyond)


def line_between(volume: Volume, ends: Floats) -> NeedleLine | None:
    """Judge the stretch between two points, (2, 3) entry and tip in P, in m; None if unseen."""
    points, contrast, seen = _contrast_along(volume, ends)
    a = (points - ends[0]) @ (ends[1] - ends[0]) / float(np.linalg.norm(ends[1] - ends[0]))
    inside = (a >= 0) & (a <= float(np.linalg.norm(ends[1] - ends[0]))) & seen
    if np.count_nonzero(inside) < 8:
        return None
    first, last = np.flatnonzero(inside)[[0, -1]]
    evidence = _STEP * np.clip(contrast[inside] - _CONTRAST, -_CONTRAST, _MAX_EVIDENCE).sum()
    return judged(
        volume,
        NeedleLine(points[[first, last]], float(evidence), *_gaps(seen, int(first), int(last))),
    )


def log_odds(volume: Volume, ends: Floats) -> float | None:
    """Return the log odds that the stretch between two points is a needle, judged by its looks.

    What is dark between the side of the field of view and the stretch does not count: the near part
    of a needle may be faint. None if the stretch is not seen. ``ends`` are (2, 3) entry and tip in
    P, in m.
    """
    line = line_between(volume, ends)
    if line is None:
        return None
    features = line_features(
        volume, line.ends, evidence=line.evidence, entry_gap=0.0, tip_gap=line.tip_gap
    )
    return sum(w * features[name] for name, w in _WEIGHTS.items())


def _contrast_along(
    volume: Volume, ends: Floats
) -> tuple[Floats, NDArray[np.float64], NDArray[np.bool_]]:
    """Return (m, 3) points on a line through the grid, their contrasts in dB, and what is seen."""
    along, across = _across(ends)
    reach = float(np.linalg.norm(volume.upper - volume.origin))
    points = ends[0] + np.arange(-reach, reach, _STEP)[:, np.newaxis] * along
    points = points[np.all((points >= volume.origin) & (points <= volume.upper), axis=1)]
    core, sides, seen = profile(
        volume.intensities,
        volume.seen,
        volume.index(points),
        _CORE @ across / volume.spacing,
        _RING @ across / volume.spacing,
        _HALF,
        _BRIGHTER,
    )
    if len(points) < 2:
        return points, core, seen
    return points, volume.decibels_per_level * uniform_filter1d(core - sides, 3), seen


def _gaps(seen: NDArray[np.bool_], first: int, last: int) -> tuple[float, float]:
    """Return the lengths seen before the first and beyond the last sample of a stretch, in m."""
    unseen = np.concatenate([[-1], np.flatnonzero(~seen), [len(seen)]])
    before = first - 1 - unseen[unseen < first].max()
    beyond = unseen[unseen > last].min() - 1 - last
    return _STEP * float(before), _STEP * float(beyond)


def needle_lines(volume: Volume) -> list[NeedleLine]:
    """Return the lines of a volume that may be needles by their looks, most probable first."""
    lines = (most_evident_line(volume, fit.ends) for fit in fitted_lines(volume, cells_of(volume)))
    possible = [judged(volume, line) for line in lines if line is not None]
    possible = [line for line in possible if line.log_odds > -math.inf]
    return _whole_needles(sorted(possible, key=lambda line: -line.log_odds))


def _whole_needles(lines: list[NeedleLine]) -> list[NeedleLine]:
    """Return lines, most probable first, without those that are parts of others.

    A part of a needle that fades may look more like one than the whole, which then is as sure.
    """
    ends = np.array([each.ends for each in lines]).reshape(-1, 2, 3)
    lengths = np.array([each.length for each in lines])
    odds = np.array([each.log_odds for each in lines])
    surest, parts = odds.copy(), np.zeros(len(lines), bool)
    for n, line in enumerate(lines):
        if line.log_odds >= 0:
            k, from_start = line.direction, ends - line.ends[0]
            along = np.clip(from_start @ k, 0, line.length)
            away = np.linalg.norm(from_start - along[..., np.newaxis] * k, axis=-1).max(axis=1)
            parallel = (ends[:, 1] - ends[:, 0]) @ k >= _PARALLEL * lengths
            here = parallel & (away <= _PART) & (lengths < _SHORTER * line.length)
            surest[n] = max(surest[n], odds[here].max(initial=-math.inf))
            parts |= here
    order = np.argsort(-surest, kind="stable")
    return [replace(lines[n], log_odds=float(surest[n])) for n in order if not parts[n]]
