"""Search for the line that looks most like a needle, in a volume without a prediction."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sonoservo.systems.localization.line_search import bright_lines
from sonoservo.systems.localization.tip import most_evident_stretch
from sonoservo.systems.signals.immutable import Immutable, NotFound, read_only
from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

MIN_EVIDENCE = 76e-3
"""Smallest evidence for a line to count as a needle, in dB m.

In 100 volumes of the phantom (seeds 100 to 199), it was exceeded in one volume without a needle,
and not reached in one with a needle of 20 to 80 mm.
"""

_STEP = 0.5e-3
"""Distance between samples along a line, in m."""

_CIRCLE = np.stack([f(np.arange(8) * np.pi / 4) for f in (np.cos, np.sin)], axis=1)
_CORE = np.concatenate([np.zeros((1, 2)), 0.6e-3 * _CIRCLE[::2]])
_RING = np.concatenate([4e-3 * _CIRCLE, 5.5e-3 * _CIRCLE])
"""Points of a cross-section that show the needle, and points that show the background, in m."""

_REFINING_RADII = (5e-3, 4e-3, 3e-3, 3e-3)
"""Radii of the cross-sections from which a line is refined, one after the other, in m."""

_AMPLITUDE = 0.35
"""Share of a cross-section's largest amplitude below which a sample is no part of a needle."""

_ASIDE = 0.7e-3
"""Distance from the line at which a cross-section has half the weight, in m."""

_CONTRAST = 4.0
"""Contrast that is evidence neither for nor against a needle, in dB above the background."""

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
        Integral along the stretch of the evidence for a needle, in dB m.
    entry_gap
        Distance from the side of the field of view to the first end, in m.
    """

    ends: Floats
    evidence: float
    entry_gap: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "ends", read_only(self.ends, "ends", (2, 3)))

    @property
    def length(self) -> float:
        """Distance between the ends, in m."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))


def localize_line(
    volume: Volume,
    rng: np.random.Generator,
    *,
    min_length: float = 17e-3,
    min_evidence: float = MIN_EVIDENCE,
    max_entry_gap: float = 8e-3,
) -> NeedleLine | NotFound:
    """Localize the line in a volume that looks most like a needle.

    The longest bright lines are refined: a line is fitted robustly to the bright centres of its
    cross-sections. A needle stands out from its surroundings along its length, and comes from
    outside. A bright fibre looks the same, so a line shorter than `min_length` does not count as a
    needle.

    Parameters
    ----------
    volume
        Volume to search.
    rng
        Generator that draws the lines.
    min_length
        Smallest visible length of a needle, in m.
    min_evidence
        Smallest evidence for a needle, in dB m.
    max_entry_gap
        Largest distance of the needle from the side of the field of view, in m.

    Returns
    -------
    The line, or a `NotFound` with the reason why there is none.
    """
    best: NeedleLine | None = None
    for ends in bright_lines(volume, rng):
        found = _stretch(volume, ends)
        if found is not None:
            # The line is fitted best between the needle's own ends.
            found = _stretch(volume, found.ends)
        if found is None or found.length < min_length or found.entry_gap > max_entry_gap:
            continue
        if best is None or found.evidence > best.evidence:
            best = found
    if best is None:
        return NotFound("no bright line comes from outside the field of view")
    if best.evidence < min_evidence:
        return NotFound("no line stands out from its surroundings as a needle does")
    return best


def _sample(volume: Volume, p_P: Floats) -> NDArray[np.float32]:
    """Return the levels in dB at (..., 3) positions in P; 0 outside the grid."""
    return np.asarray(volume.decibels_per_level * volume.sample(p_P))


def _across(ends: Floats) -> tuple[Floats, Floats]:
    """Return the (3,) unit vector along a line and (2, 3) two across it."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return along, np.linalg.svd(along[np.newaxis])[2][1:]


def _refined(volume: Volume, ends: Floats, radius: float) -> Floats:
    """Fit a line to the bright centres of its cross-sections, and return its ends."""
    along, across = _across(ends)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    a = np.arange(0, length, 2 * _STEP)
    axis = np.arange(-radius, radius + 1e-9, 1e-3)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) <= radius]
    sections = ends[0] + a[:, np.newaxis, np.newaxis] * along + grid @ across
    level = _sample(volume, sections)
    peak = level.max(axis=1, keepdims=True)
    amplitude = np.clip(10 ** ((level - peak) / 20) - _AMPLITUDE, 0, None)
    centres = amplitude @ grid / amplitude.sum(axis=1, keepdims=True)
    weights = np.clip(peak[:, 0] - np.median(level, axis=1) - 3, 0.1, 12)
    design = np.stack([np.ones_like(a), a / length], axis=1)
    near = np.ones_like(a)
    for _ in range(5):
        root = np.sqrt(weights * near)[:, np.newaxis]
        solution = np.linalg.lstsq(design * root, centres * root, rcond=None)[0]
        near = 1 / (1 + np.sum((centres - design @ solution) ** 2, axis=1) / _ASIDE**2)
    return ends + np.stack([solution[0], solution.sum(axis=0)]) @ across


def _stretch(volume: Volume, ends: Floats) -> NeedleLine | None:
    """Refine a line and return the stretch of it that looks most like a needle."""
    for radius in _REFINING_RADII:
        if np.linalg.norm(ends[1] - ends[0]) < 8 * _STEP:
            return None
        ends = _refined(volume, ends, radius)
    along, across = _across(ends)
    reach = float(np.linalg.norm(volume.upper - volume.origin))
    a = np.arange(-reach, reach, _STEP)
    points = ends[0] + a[:, np.newaxis] * along
    near = np.all((points >= volume.origin) & (points <= volume.upper), axis=1)
    a, points = a[near], points[near]
    if len(a) < 2:
        return None
    core = _sample(volume, points[:, np.newaxis] + _CORE @ across)
    ring = _sample(volume, points[:, np.newaxis] + _RING @ across)
    ring[ring == 0] = np.nan  # outside the sector
    ring[np.isnan(ring).all(axis=1), 0] = 0.0
    seen = core.max(axis=1) > 0
    contrast = uniform_filter1d(core.mean(axis=1) - np.nanmedian(ring, axis=1), 3)
    first, last, evidence = most_evident_stretch(
        contrast, seen, step=_STEP, neutral=_CONTRAST, max_evidence=_MAX_EVIDENCE
    )
    if last - first < 8:
        return None
    unseen = np.concatenate([[-1], np.flatnonzero(~seen), [len(a)]])
    before = _STEP * (first - 1 - unseen[unseen < first].max())
    beyond = _STEP * (unseen[unseen > last].min() - 1 - last)
    stretch = points[[first, last]]
    if beyond < before:
        stretch, before = stretch[::-1], beyond
    return NeedleLine(stretch, evidence, float(before))
