"""Whether a line is new: earlier volumes lack it or show it shorter, and it does not ride along."""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.localization.needle_line import refined_line
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.signals.volume import Volume

Looks = Callable[[Volume], tuple[float, float]]
"""Evidence for a line in a volume in dB m, and how far it goes beyond the line's end, in m."""

THERE_BEFORE = "a line that looks like a needle was there before, or was not seen to come"
"""Reason why a line is not followed that may have rested."""

_LOOKS = 3
"""Number of earlier volumes that must lack a line that is new, or show one that is not."""

_ASIDE, _DEEPER, _TURNED = 2e-3, 6e-3, np.deg2rad(2.0)
"""Motion of the probe across its axis and along it, in m, and turn in rad, up to which an earlier
volume shows what this one does. A specular line comes and goes with the view."""

_NEARBY = 4.0
"""Multiple of these up to which an earlier volume is from near one place, and a line that it shows
is an old one."""

_LEAST_SHARE = 0.5
"""Share of a line's evidence from which on an earlier volume shows it."""

_LEAST_EVIDENCE = 12e-3
"""Evidence of a line that is more than speckle, in dB m."""

_GROWN = 6e-3
"""Smallest length in m by which a line is shorter where its end is not shown."""

_LACKING_SHARE, _SHORTER_SHARE, _SHORTER_LOOKS = 0.25, 0.4, 2
"""Share of a line's evidence below which an earlier volume lacks it, smallest share of a shorter
line, and number of earlier volumes that must show the line shorter."""

_IN_VIEW, _BEYOND = 0.9, 4e-3
"""Share of a line, and length beyond its end in m, that are in view in an earlier volume that tells
whether the line has grown or moved."""

_AROUND, _DARKER = 5e-3, 10.0
"""Distance from a line at which its surroundings are compared, in m, and difference in dB from
which on an earlier volume shows no tissue there, as before the probe has landed."""

_DISPLACED, _PARALLEL = 8e-3, 0.9
"""Largest distance in m to a line in an earlier volume that is the same one, displaced by breath,
and smallest cosine of the angle between the two. A line farther off is elsewhere."""

_OVERLAP = 0.5
"""Smallest share of the shorter one that the two have in common."""


def is_new(
    volume: Volume,
    ends: NDArray[np.float64],
    earlier: tuple[Volume, ...],
    must_come: bool = False,
) -> bool:
    """Return True if earlier volumes lacked a line before any showed it, or if it has grown.

    A second needle, a guide wire or a fascia looks like a needle, but was there before. Only
    volumes from nearly the same place tell whether a line that they lack is new, as a specular one
    comes and goes with the view. Volumes from near one place, wherever that is, tell whether it has
    grown. What rides along with the probe is not new.

    Parameters
    ----------
    volume
        Volume in which the line was found.
    ends
        (2, 3) ends of the line in W, in m.
    earlier
        Earlier volumes in order of time.
    must_come
        Whether three of them must lack the line, or it must have grown. If not, what no volume
        shows is new, too. A line that is hardly brighter than speckle never is new then.
    """
    looks = cache(lambda each: _evidence(each, acquired_from(each, ends)))
    came = _has_come(volume, ends, earlier, must_come, looks)
    new = came or _has_grown(volume, ends, earlier, looks)
    return new and not rides_along(volume, ends, earlier)


def rides_along(volume: Volume, ends: NDArray[np.float64], earlier: tuple[Volume, ...]) -> bool:
    """Return True if most volumes from elsewhere show a line at the same place in the image.

    A reverberation does that, and the glint of a level layer. Each moves along with the probe.

    Parameters
    ----------
    volume
        Volume in which the line was found.
    ends
        (2, 3) ends of the line in W, in m.
    earlier
        Earlier volumes.
    """
    p_P = acquired_from(volume, ends)
    elsewhere = [each for each in earlier if not _is_along(acquired_from(each, ends), p_P)]
    if len(elsewhere) < _LOOKS:
        return False
    least = max(_LEAST_SHARE * _evidence(volume, p_P)[0], _LEAST_EVIDENCE)
    showing = sum(_evidence(each, p_P)[0] >= least for each in elsewhere)
    return showing >= _LOOKS and 2 * showing > len(elsewhere)


def _has_come(
    volume: Volume,
    ends: NDArray[np.float64],
    earlier: tuple[Volume, ...],
    must_come: bool,
    looks: Looks,
) -> bool:
    """Return True if volumes from nearly the same place lacked a line before any showed it."""
    near = _near(volume, earlier)
    if not near:
        return not must_come
    now, lacking = looks(volume)[0], 0
    if must_come and _LACKING_SHARE * now < _LEAST_EVIDENCE:
        return False
    least = max(_LEAST_SHARE * now, _LEAST_EVIDENCE)
    for each, distance in near:
        evidence, beyond = looks(each)
        if evidence >= least:
            return False
        if evidence >= _LEAST_EVIDENCE and (evidence >= _LACKING_SHARE * now or beyond > -_GROWN):
            continue
        lacking += distance <= 1 and _shows_tissue(each, volume, ends)
        if lacking >= (_LOOKS if must_come else 1):
            return True
    return not must_come


def _has_grown(
    volume: Volume, ends: NDArray[np.float64], earlier: tuple[Volume, ...], looks: Looks
) -> bool:
    """Return True if volumes from one place lacked a line, and then showed it shorter.

    None may have shown all of it before. What stands out of a structure varies with the view.
    """
    now, lacking, shorter = looks(volume)[0], list[Volume](), 0
    if _LACKING_SHARE * now < _LEAST_EVIDENCE:
        return False
    for each in earlier:
        if not (_is_in_view(each, ends) and _shows_tissue(each, volume, ends)):
            continue
        evidence, beyond = looks(each)
        if evidence >= _LEAST_SHARE * now and beyond > -_GROWN:
            return False
        if evidence < _LACKING_SHARE * now:
            lacking.append(each)
        elif evidence >= _SHORTER_SHARE * now and beyond <= -_GROWN:
            shorter += len(_near(each, lacking)) >= _LOOKS
        if shorter >= _SHORTER_LOOKS:
            return True
    return False


def has_moved(
    volume: Volume,
    ends: NDArray[np.float64],
    earlier: tuple[Volume, ...],
    must_come: bool = False,
) -> bool:
    """Return True unless more earlier volumes showed a line up to its end than lacked it.

    The end of a needle that moved is new, even if the rest of it is not. Volumes from near its
    place may show it or lack all of it, and those from nearly the same place may lack its end. What
    rides along with the probe has not moved by itself.

    Parameters
    ----------
    volume
        Volume in which the line was found.
    ends
        (2, 3) entry and tip in W, in m.
    earlier
        Earlier volumes.
    must_come
        Whether three of them must lack the line or its end, too.
    """
    now = _evidence(volume, acquired_from(volume, ends))[0]
    least = max(_LEAST_SHARE * now, _LEAST_EVIDENCE)
    showing = lacking = 0
    for each, distance in _near(volume, earlier):
        evidence, beyond = _evidence(each, acquired_from(each, ends))
        if evidence >= least and beyond > -_GROWN:
            showing += 1
        elif evidence < _LACKING_SHARE * now or beyond <= -_GROWN:
            looked = distance <= 1 or (evidence < _LACKING_SHARE * now and _is_in_view(each, ends))
            lacking += looked and _shows_tissue(each, volume, ends)
    came = lacking >= _LOOKS or not must_come
    shown = showing >= _LOOKS and showing > lacking
    return came and not shown and not rides_along(volume, ends, earlier)


def _near(volume: Volume, earlier: Sequence[Volume]) -> list[tuple[Volume, float]]:
    """Return the earlier volumes from near the same place, and how far each is from there."""
    return [(each, d) for each in earlier if (d := _distance(each, volume)) <= _NEARBY]


def _evidence(volume: Volume, ends: NDArray[np.float64]) -> tuple[float, float]:
    """Return the evidence for a needle along a line or near it, and how far beyond the end it goes.

    ``ends`` are those of the line in P, in m. The evidence is in dB m, the distance in m.
    """
    line = refined_line(volume, ends)
    if line is None:
        return 0.0, -np.inf
    length = float(np.linalg.norm(ends[1] - ends[0]))
    k = (ends[1] - ends[0]) / length
    first, last = np.sort((line.ends - ends[0]) @ k)
    # Something bright may lie on the line, too, beyond the needle.
    shared = min(last, length) - max(first, 0.0)
    same = _is_along(line.ends, ends) and shared >= _OVERLAP * min(last - first, length)
    return (line.evidence, float(last - length)) if same else (0.0, -np.inf)


def _is_along(line: NDArray[np.float64], ends: NDArray[np.float64]) -> bool:
    """Return True if a line, (2, 3) in P, in m, lies nearly along another one."""
    direction, k = ((b - a) / np.linalg.norm(b - a) for a, b in (line, ends))
    aside = line.mean(axis=0) - ends.mean(axis=0)
    aside = aside - (aside @ k) * k
    return bool(np.linalg.norm(aside) <= _DISPLACED and abs(direction @ k) >= _PARALLEL)


def _is_in_view(volume: Volume, ends: NDArray[np.float64]) -> bool:
    """Return True if a volume's field of view holds a line and what lies just beyond its end."""
    start, stop = acquired_from(volume, ends)
    past = stop + _BEYOND * (stop - start) / np.linalg.norm(stop - start)
    seen = volume.sees(np.linspace(start, stop, 20))
    return bool(seen.mean() >= _IN_VIEW and volume.sees(np.array([stop, past])).all())


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
