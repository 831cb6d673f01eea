"""Features that tell a needle from other bright lines."""

import math
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.needle_blur import echo_covariance

Floats = NDArray[np.float64]

_PITCH = 1e-3
"""Distance between the cross-sections that are averaged, in m."""

_RADIUS, _LINE, _NEAR = 5e-3, 0.8e-3, (2e-3, 3.2e-3)
"""Radius of a cross-section and of the line in it, and radii of the ring near the line, in m. The
rest of the cross-section is the ring far from it."""

_AMPLITUDE = 0.35
"""Share of the line's amplitude below which a point of the cross-section is no part of it."""

_FINEST = 0.45e-3
"""Standard deviation in m by which a cross-section is wider than the blur: needles have a width,
and the line's course is not known exactly."""

_NARROW, _WIDE, _UNKNOWN = 0.3, 1.15, 1.0
"""Limits of a line's width relative to the blur, and the width that speaks neither for nor against
a needle. Wider lines count alike."""

_LONG, _ENTRY = 20e-3, 8e-3
"""Length beyond which more of it tells nothing, and unit of the distance between the first end and
the side of the field of view, in m."""

_ABOVE, _BELOW, _FAR_BELOW = (
    1e-3 * np.array(each) for each in ((4, 6, 8, 10), (2.5, 3.5, 4.5), (5, 7, 9, 11, 13))
)
"""Distances from a line at which its surroundings are compared, in m."""

_MOST_EVIDENCE = 0.5
"""Logarithm of the evidence above which a line is a structure as likely as a needle."""

_EDGE = 4e-3
"""Distance from the side of the field of view over which an end of a line tells little, in m."""

_DEEPER = np.array([0.0, 1.0, 0.0])


def _disc() -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (m, 2) points of a cross-section, aside and deeper, in m, and their places.

    The places are (m,) flags of the line and (8, m) flags of the sectors of the near and of the
    far ring. The first sector lies aside, the third below.
    """
    axis = 0.75e-3 * np.arange(-6, 7)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    distance, angle = np.linalg.norm(points, axis=1), np.arctan2(points[:, 1], points[:, 0])
    sectors = np.round(angle / (np.pi / 4)).astype(int) % 8 == np.arange(8)[:, np.newaxis]
    near = (distance >= _NEAR[0]) & (distance < _NEAR[1])
    far = (distance >= _NEAR[1]) & (distance <= _RADIUS)
    return points, distance < _LINE, sectors & near, sectors & far


_POINTS, _ON_LINE, _NEAR_SECTORS, _FAR_SECTORS = _disc()
_ASIDE, _OTHER_SIDE, _OVER = 0, 4, 6


def line_features(
    volume: Volume, ends: Floats, *, evidence: float, entry_gap: float, tip_gap: float
) -> dict[str, float]:
    """Return what tells a needle from other bright lines.

    A needle is as narrow as the beam, and nothing around it is as bright. A sheet is wide. The
    surface of a bone or the border between two tissues has unlike sides above and below. A sheet,
    or the wall of a vessel, brightens what lies below; a needle shades it. A needle comes from the
    side of the field of view, goes down rather than up, and ends within. Fibres and calcifications
    are short.

    Parameters
    ----------
    volume
        Volume with the line.
    ends
        (2, 3) ends of the line in P, the one on the entry's side first, in m.
    evidence
        Integral along the line of its contrast with its sides, in dB m.
    entry_gap, tip_gap
        Distances from the side of the field of view to the first and the second end, in m.
    """
    length = float(np.linalg.norm(ends[1] - ends[0]))
    k = (ends[1] - ends[0]) / length
    points = np.linspace(ends[0], ends[1], max(int(length / _PITCH), 8))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # outside the field of view
        return {
            "constant": 1.0,
            "evidence": min(math.log(max(evidence, 1e-3) / 80e-3), _MOST_EVIDENCE),
            "short": max(1 - length / _LONG, 0.0),
            "fall": max(float(k[1]), 0.0),
            "entry gap": entry_gap / _ENTRY,
            "tip at edge": math.exp(-tip_gap / _EDGE),
            **_section_features(volume, points, k),
            **_depth_features(volume, points),
        }


def _levels(volume: Volume, points: Floats) -> Floats:
    """Return the levels at points in P, in dB; NaN outside the field of view."""
    level = volume.decibels_per_level * volume.sample(points)
    return np.where(volume.sees(points), level, np.nan)


def _limited(value: Any, lowest: float, highest: float) -> float:
    """Return a difference of levels within limits; 0, within them, if nothing is seen."""
    return float(np.clip(np.nan_to_num(value), lowest, highest))


def _section_features(volume: Volume, points: Floats, k: Floats) -> dict[str, float]:
    """Return a line's width relative to the beam's and its contrasts with what lies around it.

    The levels of its cross-sections are averaged along the line, which removes the speckle.
    """
    aside = np.cross(_DEEPER, k)
    aside /= np.linalg.norm(aside)
    across = np.array([aside, np.cross(k, aside)])
    section = np.nanmean(_levels(volume, points[:, np.newaxis] + _POINTS @ across), axis=0)
    line = np.nanmean(section[_ON_LINE])
    near, far = (
        line - np.array([np.nanmean(section[each]) for each in sectors])
        for sectors in (_NEAR_SECTORS, _FAR_SECTORS)
    )
    contrasts = {
        "near aside": np.fmin(near[_ASIDE], near[_OTHER_SIDE]),
        "near least": np.nanmin(near),
        "far above": far[_OVER],
        "far middle": np.nanmedian(far),
    }
    return {
        "width": _relative_width(volume, points, across, section - line),
        **{name: _limited(value, -12, 18) for name, value in contrasts.items()},
    }


def _relative_width(volume: Volume, points: Floats, across: Floats, levels: Floats) -> float:
    """Return the largest width of a cross-section, relative to the beam's there.

    Parameters
    ----------
    volume
        Volume with the line.
    points
        (n, 3) points of the line in P, in m.
    across
        (2, 3) unit vectors across it.
    levels
        (m,) levels of the cross-section's points above the line's, in dB.

    Returns
    -------
    The width within limits; what speaks neither for nor against a needle if the volume does not
    tell the beam's.
    """
    covariance = echo_covariance(volume, points[[0, len(points) // 2, -1]])
    if covariance is None:
        return _UNKNOWN
    blur = (across @ covariance @ across.T).mean(axis=0) + _FINEST**2 * np.eye(2)
    amplitude = np.nan_to_num(np.clip(10 ** (levels / 20) - _AMPLITUDE, 0, None))
    spread = (amplitude[:, np.newaxis] * _POINTS).T @ _POINTS / max(amplitude.sum(), 1e-9)
    largest = np.linalg.eigvalsh(spread)[1] / np.linalg.eigvalsh(blur)[1]
    return _limited(math.sqrt(max(largest, 0.0)), _NARROW, _WIDE)


def _depth_features(volume: Volume, points: Floats) -> dict[str, float]:
    """Return how unlike what lies above a line and below it are, some millimetres away."""
    offsets = np.outer(np.concatenate([-_ABOVE, _BELOW, _FAR_BELOW]), _DEEPER)
    levels = _levels(volume, points[:, np.newaxis] + offsets)
    stops = [len(_ABOVE), len(_ABOVE) + len(_BELOW)]
    above, below, far_below = (np.nanmean(each, axis=1) for each in np.split(levels, stops, axis=1))
    return {
        "behind": _limited(np.nanmean(far_below - above), 0, 8) / 2,
        "border": (_limited(np.nanmean(above - below) - 4, 0, 12) / 4) ** 2,
    }
