"""Where a needle ends along its axis: the posterior of a change point."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtr

from sonoservo.systems.sampling.interpolation import flagged, trilinear
from sonoservo.systems.sampling.kernels import OPTIONS
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import AxisProfile, NeedleExtent
from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA
from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require_positive,
)
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.volume import Volume, acquired_from
from sonoservo.systems.tracking.axis import Axis
from sonoservo.systems.tracking.line_contrast import best_stretches
from sonoservo.systems.tracking.needle_blur import needle_blur, sound_directions

_NOTHING, _SPREAD = 2.2, 0.25
"""Standard deviation of the contrast in dB where there is no needle, and by how much more a
needle's deviates from its level so far, per dB of that level: it flashes, fades and hides."""

_LASTS = 0.4
"""Share of the variance of the contrast where there is no needle that lasts from look to look."""

_CHANGES = 0.2
"""Mean length in m of a needle between places at which it hides, and between those at which its
level becomes any other. It hides for `REACH` on average, and then shows as bright as before."""

_APART, _LONG, _BRIGHT = 0.1, 0.02, 15.0
"""Mean distance and length in m of the structures on a line through tissue, and mean and standard
deviation of their contrast in dB."""

_TREND, _BEFORE = 5e-3, 1e-3
"""Length in m along which a needle's level so far is remembered to 1/e, and its distance from
there. This length, `_CHANGES`, `_NOTHING`, `_SPREAD` and `_LASTS` are fitted by
``python -m tip_study.levels`` (tests/tools)."""

_MIRROR = 16.0, 24.0
"""Contrasts in dB up to which an end is rough, and above which it mirrors sound."""

_MIRRORED, _MIRROR_ANGLE = 30.0, math.radians(10)
"""How much brighter a smooth needle is that mirrors sound back, in dB, and the angle from there in
which most of that goes (Nichols et al. 2003, and the echo of a steel cylinder)."""

REACH = 20e-3
"""Mean length in m of what is not seen of a needle, beyond where it was last seen."""

_MOVES = 0.05
"""Probability that the tissue has moved in W since the last volume, so that it tells nothing."""

_SURE = 0.95
"""Probability that the tip was not at a place from which on that place is a record of tissue."""

_NEAR, _PLACES = 6e-3, 3
"""Distance in m within which ends are one end, and number of ends that are distinguished."""

_EMPTY = 15.0
"""Level of the background in dB, below that around the needle, at which there is no tissue."""

_TYPICAL_WIDTH = 2e-3
"""Width of a beam in m where there is no speckle from which it could be measured."""

_RING, _HEXAGON = (
    np.array([[np.cos(t), np.sin(t)] for t in np.arange(n) * np.pi / (n // 2)]) for n in (8, 6)
)
_HALF = 0.5 * _HEXAGON @ np.array([[0.866, 0.5], [-0.5, 0.866]])
_DISC = np.vstack([np.zeros((1, 2)), _HALF, _HEXAGON])
"""Points of the unit circle, and of the disc in it, at which levels are taken."""


@dataclass(kw_only=True)
class TipParameters:
    """Parameters of the search for the needle's ends in the intensity along its axis.

    Parameters
    ----------
    step
        Distance between samples along the axis, in m.
    tube_radius
        Radius of the tube over which the maximum is taken, in m.
    background_radius
        Distance from the axis of the tubes that show the background, in m.
    contrast
        Contrast halfway between the background and a faint needle, in dB. More is evidence for the
        needle, less is evidence against it.
    max_evidence
        Largest evidence of one sample for the needle, in dB above ``contrast``.
    smoothing
        Length over which the intensity is averaged, in m.
    bevel_length
        Length of the ground part of the tip along the needle, in m. It scatters less than the shaft
        or more, as it is turned, so a rough end may be that of the shaft or the foremost point.
    beam_width
        Width of the beam along the needle at half amplitude, in m. The beam blurs the tip outwards.
        This value is used only for volumes that do not know their point spread; if it is None, the
        widths there follow from the speckle.
    """

    step: Positive = 0.25e-3
    tube_radius: Positive = 1.0e-3
    background_radius: Positive = 5e-3
    contrast: Positive = 3.0
    max_evidence: Positive = 3.0
    smoothing: Positive = 1.25e-3
    bevel_length: NotNegative = 4e-3
    beam_width: float | None = None

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.beam_width is not None:
            require_positive(beam_width=self.beam_width)


@njit(**OPTIONS)
def _levels(  # pragma: no cover - compiled
    intensities: Any, seen: Any, origin: Any, spacing: Any, p_P: Any, tubes: Any, disc: Any
) -> Any:
    """Return the largest samples around (m, 3) positions, -1 if unseen, and the medians beside.

    The first of the ``tubes`` is around the positions themselves.
    """
    nx, ny, nz = intensities.shape
    level, background, beside = np.empty(len(p_P)), np.zeros(len(p_P)), np.empty(len(tubes))
    for m in range(len(p_P)):
        count = 0
        for n in range(len(tubes)):
            largest = -1.0
            for q in range(len(disc)):
                x = (p_P[m, 0] + tubes[n, 0] + disc[q, 0] - origin[0]) / spacing[0]
                y = (p_P[m, 1] + tubes[n, 1] + disc[q, 1] - origin[1]) / spacing[1]
                z = (p_P[m, 2] + tubes[n, 2] + disc[q, 2] - origin[2]) / spacing[2]
                if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1):
                    continue
                value = trilinear(intensities, x, y, z)
                if value > largest and flagged(seen, x, y, z):
                    largest = value
            if n == 0:
                level[m] = largest
            elif largest >= 0:  # Positions outside the sector say nothing about the background.
                at = count
                while at > 0 and beside[at - 1] > largest:
                    beside[at] = beside[at - 1]
                    at -= 1
                beside[at] = largest
                count += 1
        if count > 0:
            background[m] = (beside[(count - 1) // 2] + beside[count // 2]) / 2
    return level, background


def axis_profile(
    volume: Volume, axis: Axis, start: float, stop: float, parameters: TipParameters
) -> AxisProfile:
    """Sample the levels along an axis in W, and those around it, between two abscissae in m."""
    a = np.arange(start, stop + parameters.step, parameters.step)
    p_W = axis.position(a)
    p_P = acquired_from(volume, p_W)
    # One plane across the needle serves all points, as the curve bends little.
    along = volume.X_WP.rotation().matrix().T @ axis.direction
    across = np.linalg.svd(along[np.newaxis])[2][1:]
    level, background = _levels(
        volume.intensities,
        volume.seen,
        volume.origin,
        volume.spacing,
        p_P,
        np.vstack([np.zeros(3), parameters.background_radius * _RING @ across]),
        parameters.tube_radius * _DISC @ across,
    )
    inside = np.all((p_P >= volume.origin) & (p_P <= volume.upper), axis=1)
    if volume.motion is not None:
        inside &= volume.motion.geometry.contains(p_P)
    return AxisProfile(
        a,
        p_W,
        level.clip(0) * volume.decibels_per_level,
        background * volume.decibels_per_level,
        inside & (level >= 0),
        needle_blur(volume, p_P, along, parameters.beam_width),
        parameters.contrast,
        np.arcsin(np.clip(np.abs(sound_directions(volume, p_P) @ along), 0, 1)),
        white=255 * volume.decibels_per_level,
    )


def most_evident_stretch(
    contrast: NDArray[np.float64],
    seen: NDArray[np.bool_],
    *,
    step: float,
    neutral: float,
    max_evidence: float,
) -> tuple[int, int, float]:
    """Return first and last sample of the stretch with most evidence, and the evidence in dB m.

    A sample more than ``neutral`` dB above the background is evidence for it, any other against it;
    an unseen one counts as 0 dB. Without evidence, the last index is below the first.
    """
    evidence = np.where(seen, np.clip(contrast - neutral, -neutral, max_evidence), -neutral)
    (first,), (last,), _ = best_stretches(evidence[np.newaxis])
    return first, last, float(evidence[first : last + 1].sum()) * step


def find_extent(profile: AxisProfile, parameters: TipParameters) -> NeedleExtent | NotFound:
    """Find the ends of a needle along its axis (Chatelain 2013, end of section II-D)."""
    # It begins where the `most_evident_stretch` does. Its tip is a change point: the contrast
    # follows the needle's level so far, which may fade, up to a blurred end. The needle may hide
    # and show again, and beyond its end there may be structures, so what shines beyond a gap is
    # either, unless the tissue there was seen before the needle came.
    step = float(profile.a[1] - profile.a[0])
    samples = max(1, round(parameters.smoothing / step))
    level = uniform_filter1d(profile.level, samples, mode="nearest")
    contrast = level - uniform_filter1d(profile.background, samples, mode="nearest")
    first, last, evidence = most_evident_stretch(
        contrast,
        profile.seen,
        step=step,
        neutral=parameters.contrast,
        max_evidence=parameters.max_evidence,
    )
    if last < 0:
        return NotFound(SearchReason.NOTHING_ALONG(" the axis stands out from the background"))
    width = profile.beam_width
    if width is None:
        width = np.full(len(contrast), parameters.beam_width or _TYPICAL_WIDTH)
    share = step / np.maximum(width, parameters.smoothing)
    sigma = width / FWHM_PER_SIGMA
    # The tissue is as it was before the needle came, or it has moved since the last volume.
    nothing = np.zeros(len(contrast))
    cases = [(nothing, nothing, 1.0)]
    if profile.before is not None and profile.looks is not None:
        cases = [(nothing, nothing, _MOVES), (profile.before, profile.looks, 1 - _MOVES)]
    tissue = np.array([_tissue(before, looks) for before, looks, _ in cases])
    priors = np.array([math.log(prior) for _, _, prior in cases])
    logs, beyond, tops = _end_logs(contrast, profile.seen, tissue, share, sigma, step, first)
    weights, rests = _end_weights(profile.a, first, logs + priors[:, np.newaxis], beyond + priors)
    passed = np.interp(profile.a - 3 * sigma, profile.a, np.cumsum(weights.sum(axis=0)))
    places = _places(profile.a, weights.sum(axis=0), rests.sum())
    seen, tip, std = places[0]
    at, beyond_at = np.searchsorted(profile.a[:-1], [tip, tip + REACH / 2])
    around = uniform_filter1d(profile.background, round(_TREND / step))
    law, echogenic = np.zeros(len(contrast)), 0.0
    if profile.incidence is not None:
        law = _MIRRORED * np.exp(-profile.incidence / _MIRROR_ANGLE)
        # No mirror is brighter than white. What would be, if it faced the sound, is echogenic.
        facing = float(around[at] + tops[at] + _MIRRORED - law[at])
        echogenic = float(ndtr((facing - profile.white) / _NOTHING))
    turned = float(law[beyond_at] - law[at])
    # Any part of a bevel may be hidden, but where the shaft mirrors sound: there the bevel, which
    # does not, is as bright as the needle is elsewhere. Many an echogenic needle has a smooth
    # bevel, which is hidden; another is echogenic to its very point.
    mirror = _mirror_share(tops[at])
    rough = 1 - mirror
    elsewhere = float((contrast - law)[first : at + 1].mean())
    dull = mirror * _unseen(elsewhere, 0.0, parameters.contrast)
    bevel = (rough * echogenic / 2 + dull) * parameters.bevel_length / 2
    # Outside the tissue nothing scatters, so a needle that enters it in view comes from nowhere.
    empty = around < np.median(around[first : last + 1]) - _EMPTY
    unseen = np.flatnonzero(~profile.seen[:first] | empty[:first])
    after = np.searchsorted(profile.a, max(profile.a[last], tip) + parameters.smoothing)
    return NeedleExtent(
        start=float(profile.a[first]),
        end=float(profile.a[last]),
        tip=float(tip),
        tip_std=float(std),
        bevel=bevel,
        bevel_std=math.sqrt((rough + dull) * parameters.bevel_length**2 / 3 - bevel**2),
        unseen=_unseen(float(tops[at]), turned, parameters.contrast),
        seen=float(seen),
        elsewhere=places[1:] - [0.0, tip, 0.0],
        entered=float(profile.a[unseen[-1]]) if len(unseen) else -np.inf,
        leaves=bool(after >= len(profile.a) or not profile.seen[after]),
        evidence=evidence,
        contrast=contrast,
        ahead=profile.seen & (passed > _SURE),
        as_before=min(float(weights[-1].sum() + rests[-1]), 1.0),
    )


def _tissue(before: NDArray[np.float64], looks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (m, 3) properties of the contrasts that are expected where the needle is not.

    They are means and deviations in dB, and shares of the structures that were not seen before.
    """
    # Structures stand out by any level, so how much of a contrast lasts is told by what was seen.
    lasting, changing = _LASTS * _NOTHING**2 + before**2, (1 - _LASTS) * _NOTHING**2
    gain = looks * lasting / (looks * lasting + changing)
    mean = gain * before
    std = np.sqrt(changing + (1 - gain) * lasting) + _flicker(mean)
    return np.stack([mean, std, 1 - gain], axis=1)


@njit(**OPTIONS)
def _flicker(level: Any) -> Any:
    """Return by how much more the contrast of what has a level in dB deviates, in dB."""
    return _SPREAD * np.minimum(np.maximum(level, 0.0), 16.0)


@njit(**OPTIONS)
def _log_density(contrast: float, mean: float, std: float) -> float:  # pragma: no cover
    return -0.5 * ((contrast - mean) / std) ** 2 - math.log(std)


@njit(**OPTIONS)
def _needle_logs(  # pragma: no cover - compiled
    contrast: Any, seen: Any, tissue: Any, share: Any, step: float, first: int
) -> Any:
    """Return (m + 1,) log likelihoods of the contrasts before each sample along a needle."""
    m = len(contrast)
    logs, shown = np.zeros(m + 1), np.ones(m + 1)
    gap, kept = int(_BEFORE / step), math.exp(-step / _TREND)
    total, count, end = 0.0, 0.0, first
    # Probabilities that it shows as bright as so far, and with another level.
    same, anew = 1.0, 0.0
    for b in range(first, m):
        # Its level is that of what has shown so far, so that it outlasts what hides it.
        while end < min(max(b - gap, first + gap), m):
            total, count = kept * total, kept * count
            if seen[end]:
                total, count = total + shown[end] * contrast[end], count + shown[end]
            end += 1
        changes, lasts = same * step / _CHANGES, anew * step / _TREND
        same += (1 - same - anew) * step / REACH + lasts - 2 * changes
        anew += changes - lasts
        logs[b + 1] = logs[b]
        if seen[b]:
            level = max(total / count, 0.0) if count > 0 else 0.0
            # What speckle alone would add to the mean is taken off, as in Wiener's filter.
            level = level**3 / (level**2 + 1.5)
            std = _NOTHING + _flicker(level)
            before = share[b] * _log_density(contrast[b], level, std)
            bright = share[b] * _log_density(contrast[b], _BRIGHT, _BRIGHT)
            hidden = share[b] * _log_density(contrast[b], tissue[b, 0], tissue[b, 1])
            top = max(before, bright, hidden)
            hides = (1 - same - anew) * math.exp(hidden - top)
            same, anew = same * math.exp(before - top), anew * math.exp(bright - top)
            whole = same + anew + hides
            same, anew = same / whole, anew / whole
            logs[b + 1] += top + math.log(whole)
        shown[b] = same + anew
    return logs


@njit(**OPTIONS)
def _tissue_logs(  # pragma: no cover - compiled
    contrast: Any, seen: Any, tissue: Any, share: Any, step: float
) -> Any:
    """Return (m + 1,) log likelihoods of the contrasts from each sample on beyond a needle."""
    m = len(contrast)
    logs, structure = np.zeros(m + 1), 0.0
    for b in range(m - 1, -1, -1):
        nothing = logs[b + 1]
        if seen[b]:
            nothing += share[b] * _log_density(contrast[b], tissue[b, 0], tissue[b, 1])
            structure += share[b] * _log_density(contrast[b], _BRIGHT, _BRIGHT)
        logs[b] = _log_mean(structure, nothing, tissue[b, 2] * step / _APART)
        structure = _log_mean(nothing, structure, step / _LONG)
    return logs


@njit(**OPTIONS)
def _log_mean(a: float, b: float, share: float) -> float:  # pragma: no cover - compiled
    """Return the logarithm of the mean of two numbers, given theirs and the share of the first."""
    top = max(a, b)
    return top + math.log(share * math.exp(a - top) + (1 - share) * math.exp(b - top))


@njit(**OPTIONS)
def _mirror_share(top: float) -> float:  # pragma: no cover - compiled
    """Return the share to which an end with a contrast in dB before it mirrors sound."""
    return min(max((top - _MIRROR[0]) / (_MIRROR[1] - _MIRROR[0]), 0.0), 1.0)


@njit(**OPTIONS)
def _end_logs(  # pragma: no cover - compiled
    contrast: Any, seen: Any, tissue: Any, share: Any, sigma: Any, step: float, first: int
) -> Any:
    """Return log likelihoods of a needle that ends at each sample, or beyond, and contrasts.

    They are (c, m), (c,) and (m,), for (c, m, 3) properties of the ``tissue`` in c cases. ``share``
    is the evidence of a sample in beam widths, and ``sigma`` the standard deviation of the blurred
    end in m. The contrasts in dB are those shortly before each end.
    """
    m, gap, cases = len(contrast), int(_BEFORE / step), range(len(tissue))
    needle = [_needle_logs(contrast, seen, each, share, step, first) for each in tissue]
    beyond = [_tissue_logs(contrast, seen, each, share, step) for each in tissue]
    there = 10 ** (tissue[:, :, 0] / 10)
    logs, tops = np.full((len(tissue), m), -np.inf), np.zeros(m)
    for t in range(first + 2 * gap, m):
        tops[t] = contrast[max(t - 4 * gap, first) : max(t - gap, first + 1)].mean()
        # A bevel tapers, so what ends is the level within a beam's width of the end.
        beam = max(int(FWHM_PER_SIGMA * sigma[t] / step), 1)
        top = contrast[max(t - beam, first) : t].mean()
        mirror = _mirror_share(top)
        begin, end = t - int(sigma[t] / step), min(t + int(3 * sigma[t] / step), m - 1)
        begin = max(begin, first)
        for n in cases:
            logs[n, t] = needle[n][begin] + beyond[n][end + 1]
        for b in range(begin, end + 1):
            if seen[b]:
                # Of points in phase the amplitudes add up, of others the intensities.
                x, drop = (b - t) * step / sigma[t], 0.0
                if mirror > 0:
                    drop += mirror * math.log(max(0.5 * math.erfc(x / math.sqrt(2)), 1e-9))
                if mirror < 1:
                    drop += (1 - mirror) * (0.5 * math.log(max(0.5 * math.erfc(x), 1e-9)))
                shine = 10 ** (top / 10) * math.exp(2 * drop)
                for n in cases:
                    left = 10 * math.log10(there[n, b] + shine)
                    logs[n, t] += share[b] * _log_density(contrast[b], left, tissue[n, b, 1])
    return logs, np.array([each[m] for each in needle]), tops


def _end_weights(
    a: NDArray[np.float64], first: int, logs: NDArray[np.float64], beyond: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (c, m) probabilities that the tip is at each sample, and (c,) that it is beyond.

    ``logs`` are the log likelihoods of the same, of c cases that exclude each other.
    """
    top = max(float(logs.max()), float(beyond.max()))
    farther = (a - a[first]) / REACH
    weights = np.exp(logs - top - farther) * (float(a[1] - a[0]) / REACH)
    rests = np.exp(beyond - top - farther[-1])
    total = weights.sum() + rests.sum()
    return weights / total, rests / total


def _places(
    a: NDArray[np.float64], weights: NDArray[np.float64], rest: float
) -> NDArray[np.float64]:
    """Return the places where the tip may be: (c, 3) probabilities, abscissae and deviations in m.

    The most probable ones come first, and all that is left last.
    """
    step, rest_at = float(a[1] - a[0]), float(a[-1]) + REACH
    near = round(_NEAR / step)
    places = []
    for _ in range(_PLACES):
        middle = int(np.convolve(weights, np.ones(2 * near + 1), "same").argmax())
        here = slice(max(middle - near, 0), middle + near + 1)
        probability = weights[here].sum()
        if probability > 0:
            # The posterior is skewed: a flank may fade, and nothing begins before it.
            tip = a[here][weights[here].argmax()]
            variance = weights[here] @ ((a[here] - tip) ** 2 + step**2) / probability
            places.append((probability, tip, math.sqrt(variance)))
        weights[here] = 0
    left = weights.sum() + rest
    if left > 0:
        mean = (weights @ a + rest * rest_at) / left
        variance = (weights @ (a - mean) ** 2 + rest * ((rest_at - mean) ** 2 + REACH**2)) / left
        places.append((left, mean, math.sqrt(variance + step**2)))
    return np.array(places)


def _unseen(top: float, turned: float, neutral: float) -> float:
    """Return the probability that a needle goes on beyond an end, no brighter than tissue.

    Its contrast is ``top`` dB before the end, changed by ``turned`` dB as the sound meets it at
    another angle there.
    """
    return float(ndtr((neutral - max(top, 0.0) - turned) / (_NOTHING + _flicker(top))))
