"""Whether a line is new: earlier volumes from nearly the same place lack it."""

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.localization.needle_line import refined_line
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.signals.volume import Volume

THERE_BEFORE = "a line that looks like a needle was there before, or was not seen to come"
"""Reason why a line is not followed that may have rested."""

_LOOKS = 3
"""Number of earlier volumes that must lack a line that is new, or show one that is not."""

_ASIDE, _DEEPER, _TURNED = 2e-3, 6e-3, np.deg2rad(2.0)
"""Motion of the probe across its axis and along it, in m, and turn in rad, up to which an earlier
volume shows what this one does. A specular line comes and goes with the view."""

_NEARBY = 4.0
"""Multiple of these up to which a line that an earlier volume shows is an old one."""

_LEAST_SHARE = 0.5
"""Share of a line's evidence from which on an earlier volume shows it."""

_LEAST_EVIDENCE = 12e-3
"""Evidence of a line that is more than speckle, in dB m."""

_GROWN = 6e-3
"""Length in m by which a needle has grown at least since a volume did not show its end."""

_AROUND, _DARKER = 5e-3, 10.0
"""Distance from a line at which its surroundings are compared, in m, and difference in dB from
which on an earlier volume shows no tissue there, as before the probe has landed."""

_DISPLACED, _PARALLEL = 8e-3, 0.9
"""Largest distance in m to a line in an earlier volume that is the same one, displaced by breath,
and smallest cosine of the angle between the two."""


def is_new(
    volume: Volume,
    ends: NDArray[np.float64],
    earlier: tuple[Volume, ...],
    must_come: bool = False,
) -> bool:
    """Return True if earlier volumes lacked a line before any showed it.

    A second needle, a guide wire or a fascia looks like a needle, but was there before. Only
    volumes from nearly the same place tell.

    Parameters
    ----------
    volume
        Volume in which the line was found.
    ends
        (2, 3) ends of the line in W, in m.
    earlier
        Earlier volumes in order of time.
    must_come
        Whether three of them must lack the line. If not, what no volume shows is new, too.
    """
    near = _near(volume, earlier)
    if not near:
        return not must_come
    least, lacking = _least_evidence(volume, ends), 0
    for each, distance in near:
        if _evidence(each, ends)[0] >= least:
            return False
        lacking += distance <= 1 and _shows_tissue(each, volume, ends)
        if lacking >= (_LOOKS if must_come else 1):
            return True
    return not must_come


def was_there(volume: Volume, ends: NDArray[np.float64], earlier: tuple[Volume, ...]) -> bool:
    """Return True if more earlier volumes showed a line up to its end than lacked it.

    The end of a needle that moved is new, even if the rest of it is not. Volumes from near its
    place may show it, and those from nearly the same place may lack it.

    Parameters
    ----------
    volume
        Volume in which the line was found.
    ends
        (2, 3) entry and tip in W, in m.
    earlier
        Earlier volumes.
    """
    near = _near(volume, earlier)
    least, showing, lacking = _least_evidence(volume, ends), 0, 0
    for each, distance in near:
        evidence, beyond = _evidence(each, ends)
        if evidence >= least and beyond > -_GROWN:
            showing += 1
        else:
            lacking += distance <= 1 and _shows_tissue(each, volume, ends)
    return showing >= _LOOKS and showing > lacking


def _near(volume: Volume, earlier: tuple[Volume, ...]) -> list[tuple[Volume, float]]:
    """Return the earlier volumes from near the same place, and how far each is from there."""
    return [(each, d) for each in earlier if (d := _distance(each, volume)) <= _NEARBY]


def _least_evidence(volume: Volume, ends: NDArray[np.float64]) -> float:
    """Return the evidence from which on another volume shows a line, in dB m."""
    return max(_LEAST_SHARE * _evidence(volume, ends)[0], _LEAST_EVIDENCE)


def _evidence(volume: Volume, ends: NDArray[np.float64]) -> tuple[float, float]:
    """Return the evidence for a needle along a line or near it, and how far beyond the end it goes.

    The first is in dB m, the second in m.
    """
    ends = acquired_from(volume, ends)
    line = refined_line(volume, ends)
    if line is None:
        return 0.0, -np.inf
    k = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    aside = line.ends.mean(axis=0) - ends.mean(axis=0)
    aside = aside - (aside @ k) * k
    same = np.linalg.norm(aside) <= _DISPLACED and abs(line.direction @ k) >= _PARALLEL
    return (line.evidence if same else 0.0), float(((line.ends - ends[1]) @ k).max())


def _shows_tissue(before: Volume, volume: Volume, ends: NDArray[np.float64]) -> bool:
    """Return True if an earlier volume is not much darker around a line."""
    levels = []
    for each in (before, volume):
        start, stop = acquired_from(each, ends)
        points = np.linspace(start, stop, 20)
        aside = np.cross(points[-1] - points[0], [0.0, 1.0, 0.0])
        aside *= _AROUND / max(float(np.linalg.norm(aside)), 1e-9)
        beside = each.sample(np.concatenate([points - aside, points + aside]))
        levels.append(each.decibels_per_level * float(beside.mean()))
    return levels[0] > levels[1] - _DARKER


def _distance(before: Volume, volume: Volume) -> float:
    """Return how far the probe was moved between two volumes, relative to what shows the same."""
    X = before.X_WP.inverse().multiply(volume.X_WP)
    x, y, z = X.translation()
    turn = float(X.rotation().ToAngleAxis().angle())
    return max(float(np.hypot(x, z)) / _ASIDE, abs(y) / _DEEPER, turn / _TURNED)
