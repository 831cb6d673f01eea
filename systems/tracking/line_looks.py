"""Looks of a line in a single volume, which tell a needle from other bright lines."""

import math
import warnings

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.line_contrast import across, cross_sections
from sonoservo.systems.tracking.needle_blur import echo_covariance, streak_lengths

Floats = NDArray[np.float64]

_RADII = 1e-3 * np.array([0.8, 1.5, 2.2, 3.0, 3.8, 4.6, 7.0, 10.0, 13.0])
_WIDTH, _NEAR, _FAR, _AROUND = slice(0, 6), slice(2, 4), slice(4, 6), slice(5, 8)
"""Radii in m of the circles around a line, and those that show its width, what lies near it, what
lies outside the beam, and what lies above and below."""

_ASIDE, _ABOVE, _OTHER_SIDE, _BELOW = 0, 2, 4, 6

_AREAS = _RADII[_WIDTH] * np.gradient(_RADII[_WIDTH]) * (math.pi / 4)
_MIDDLE = math.pi * (0.5 * _RADII[0]) ** 2
_SIDES = np.stack([f(math.pi / 4 * np.arange(8)) for f in (np.cos, np.sin)], axis=-1)
_POINTS = _RADII[_WIDTH, np.newaxis, np.newaxis] * _SIDES
"""Areas in m^2 that the points of the circles stand for, and the middle; (8, 2) directions of the
sectors, and (r, 8, 2) those points in m."""

_AMPLITUDE = 0.35
"""Share of the line's amplitude below which a point does not belong to the cross-section."""

_WIDTHS = 0.3, 1.4
"""Limits of a line's width relative to the beam's: wider lines count alike."""

_FINEST = 0.45e-3
"""Standard deviation in m by which a cross-section is wider than the blur: needles have a width,
and the line's course is not known exactly."""

_LONG, _ENTRY, _EDGE = 20e-3, 8e-3, 4e-3
"""Units in m: length beyond which more of it tells nothing, and distances from the sides of the
field of view to the ends."""

_WEIGHTS = {
    "constant": -0.02,
    "evidence": 1.90,
    "clutter": -2.35,
    "short": 2.15,
    "streak": -15.75,
    "fall": 2.66,
    "entry gap": -0.47,
    "tip at edge": -1.24,
    "width": 1.44,
    "aside": -2.04,
    "around": -19.78,
    "outside": 14.72,
    "behind": -0.65,
    "border": -1.27,
    "rim": -11.50,
}
"""Weights of a line's looks in the logarithm of the odds that it is the needle of a volume, rather
than that there is none, if every second volume has one. They are those of a conditional logit (a
volume has one needle or none) on the lines of own scans and painted images, seeds 1000 to 1259, two
of three, made and fitted by ``python -m looks_study`` (tests/tools)."""


def line_looks(
    volume: Volume,
    ends: Floats,
    *,
    evidence: Floats,
    clutter: float,
    entry_gap: Floats,
    tip_gap: Floats,
) -> dict[str, Floats]:
    """Return the looks of lines, each (n,), from the entry's end to the tip's in P; gaps in m.

    ``clutter`` is the median evidence of the volume's bright lines: where there are many, one more
    tells little. Gaps are distances from the side of the field of view.
    """
    # A needle is as narrow as the beam, and at most one side is as bright, where it reverberates. A
    # sheet is wide, with two such sides. A bone's surface, or the border of two tissues, has unlike
    # sides above and below. A sheet, or the wall of a vessel, brightens what lies below; a needle
    # shades it. A needle comes from the side of the field of view, goes down rather than up, and
    # ends within. Fibres and calcifications are short. Far from the lens's focus, a point is drawn
    # out to a streak across the frames.
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    k = along / length[:, np.newaxis]
    section, shares = cross_sections(volume, ends, _RADII)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # outside the field of view
        near, far = np.nanmean(section[:, _NEAR], axis=1), np.nanmean(section[:, _FAR], axis=1)
        above = np.nanmean(section[:, _AROUND, _ABOVE], axis=1)
        below = np.nanmean(section[:, 3:6, _BELOW], axis=1)
        far_below = np.nanmedian(section[:, 5:, _BELOW], axis=1)
    blur = _blur(volume, ends, k)
    beside = _amplitudes(near) - _spread(blur, _NEAR)
    farther = _amplitudes(far) - _spread(blur, _FAR)
    streaks = streak_lengths(volume, ends)
    return {
        "constant": np.ones(len(ends)),
        "evidence": np.log(np.maximum(evidence, 1e-3) / 30),
        "clutter": np.full(len(ends), math.log(max(clutter, 1.0) / 30)),
        "short": np.maximum(1 - length / _LONG, 0.0),
        "streak": np.minimum(streaks / length, 1.0),
        "fall": np.maximum(k[:, 1], 0.0),
        "entry gap": np.minimum(entry_gap / _ENTRY, 3.0),
        "tip at edge": np.exp(-tip_gap / _EDGE),
        "width": np.ones(len(ends)) * np.clip(_relative_width(blur, section[:, _WIDTH]), *_WIDTHS),
        "aside": np.maximum(beside[:, _ASIDE], beside[:, _OTHER_SIDE]),
        "around": np.sort(beside, axis=1)[:, -2],
        "outside": np.median(farther, axis=1),
        "behind": _limited(above - far_below, 0, 8) / 2,
        "border": (_limited(below - above - 4, 0, 12) / 4) ** 2,
        "rim": 1 - shares[:, 3].mean(axis=1),
    }


def _limited(values: Floats, lowest: float, highest: float) -> Floats:
    """Return differences of levels clipped to limits, as if they were 0 where nothing is seen."""
    return np.asarray(np.clip(np.nan_to_num(values), lowest, highest))


def _amplitudes(contrasts: Floats) -> Floats:
    """Return the amplitudes of sectors relative to the line's; 0 where nothing is seen."""
    return np.asarray(10 ** (-np.clip(np.nan_to_num(contrasts, nan=40.0), -12, 40) / 20))


def _blur(volume: Volume, ends: Floats, k: Floats) -> Floats | None:
    """Return the (n, 2, 2) covariances in m^2 of points' echoes across lines, averaged along each.

    None if the volume does not tell the beam's width. ``k`` are the lines' (n, 3) directions.
    """
    n = len(ends)
    covariance = echo_covariance(volume, np.linspace(ends[:, 0], ends[:, 1], 3).reshape(-1, 3))
    if covariance is None:
        return None
    sides = across(k)
    blur = sides @ covariance.reshape(3, n, 3, 3).mean(axis=0) @ sides.swapaxes(1, 2)
    return np.asarray(blur + _FINEST**2 * np.eye(2))


def _spread(blur: Floats | None, circles: slice) -> Floats | float:
    """Return the (n, 8) amplitudes to which the beam alone spreads a line's echo on circles."""
    if blur is None:
        return 0.0
    variance = np.einsum("nij,si,sj->ns", blur, _SIDES, _SIDES)
    return np.asarray(np.exp(-0.5 * np.mean(_RADII[circles] ** 2) / variance))


def _relative_width(blur: Floats | None, section: Floats) -> Floats | float:
    """Return the largest widths of (n, r, 8) cross-sections in dB, relative to the beam's there."""
    if blur is None:
        return 1.0
    amplitude = np.nan_to_num(np.clip(10 ** (-section / 20) - _AMPLITUDE, 0, None))
    weights = amplitude * _AREAS[:, np.newaxis]
    total = weights.sum(axis=(1, 2)) + (1 - _AMPLITUDE) * _MIDDLE
    spread = np.einsum("nrs,rsi,rsj->nij", weights, _POINTS, _POINTS)
    spread = spread / total[:, np.newaxis, np.newaxis]
    largest = np.linalg.eigvalsh(spread)[:, 1] / np.linalg.eigvalsh(blur)[:, 1]
    return np.asarray(np.sqrt(np.maximum(largest, 0.0)))


def looks_odds(looks: dict[str, Floats]) -> Floats:
    """Return the (n,) log odds that each line is the needle, rather than that there is none."""
    return np.asarray(sum(weight * looks[name] for name, weight in _WEIGHTS.items()))
