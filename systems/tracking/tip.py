"""Search for the needle's ends along its axis."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtri

from sonoservo.systems.sampling.interpolation import flagged, trilinear
from sonoservo.systems.signals.acquisition import acquired_from
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import AxisProfile, NeedleExtent
from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA
from sonoservo.systems.signals.requirements import require_positive
from sonoservo.systems.signals.search_reason import SearchReason
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis import Axis
from sonoservo.systems.tracking.faint_end import FAINT_STD, faint_part
from sonoservo.systems.tracking.hidden_length import hidden_length
from sonoservo.systems.tracking.line_contrast import best_stretches
from sonoservo.systems.tracking.needle_blur import needle_blur

_END_SHARE = 0.45
"""Standard deviation of a clear and abrupt end, relative to that of the blur."""

_ABRUPT_DROP, _FADED = 8.0, 1.25
"""Drop of the contrast in dB, over two standard deviations of the blur, at which an end is abrupt,
and the logarithm of the factor on the standard deviation without any drop."""

_ROUGH_CONTRAST, _MIRROR_CONTRAST = 16.0, 24.0
"""Contrast in dB up to which an end is rough, and from which on it is like a mirror."""

_CLEAR_CONTRAST, _FAINT = 14.0, 3.6
"""Contrast in dB at which an end is clear, and the logarithm of the factor without any contrast.
All five were fitted to 640 volumes of two image models with sharp, faint and fading needles."""


_EMPTY = 15.0
"""Level of the background in dB, below that around the needle, at which there is no tissue."""

_TYPICAL_WIDTH = 2e-3
"""Width of a beam in m where there is no speckle from which it could be measured."""


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
    end_contrast, min_end_contrast
        Largest and smallest contrast below which the blurred end of the needle is lost in the
        background, in dB. In between, it is half the needle's contrast near its end.
    end_length
        Length of needle whose largest contrast is the end's level, in m. The needle's contrast near
        its end is the median over twice this length.
    beam_width
        Width of the beam along the needle at half amplitude, in m. The beam blurs the tip outwards.
        This value is used only for volumes that do not know their point spread; if it is None, the
        widths there follow from the speckle.
    """

    step: float = 0.25e-3
    tube_radius: float = 1.0e-3
    background_radius: float = 5e-3
    contrast: float = 3.0
    max_evidence: float = 3.0
    smoothing: float = 1.25e-3
    end_contrast: float = 6.0
    min_end_contrast: float = 4.0
    end_length: float = 4e-3
    beam_width: float | None = None

    def __post_init__(self) -> None:
        require_positive(
            step=self.step,
            tube_radius=self.tube_radius,
            background_radius=self.background_radius,
            contrast=self.contrast,
            max_evidence=self.max_evidence,
            smoothing=self.smoothing,
            end_contrast=self.end_contrast,
            min_end_contrast=self.min_end_contrast,
            end_length=self.end_length,
        )
        if self.beam_width is not None:
            require_positive(beam_width=self.beam_width)


@njit(cache=True, nogil=True, error_model="numpy")
def _tube_maxima(  # pragma: no cover - compiled
    intensities: Any, seen: Any, origin: Any, spacing: Any, centres: Any, offsets: Any
) -> Any:
    """Return the largest sample among `offsets` around each of (m, 3) centres; -1 if unseen."""
    nx, ny, nz = intensities.shape
    maxima = np.full(centres.shape[0], -1.0)
    for m in range(centres.shape[0]):
        for q in range(offsets.shape[0]):
            x = (centres[m, 0] + offsets[q, 0] - origin[0]) / spacing[0]
            y = (centres[m, 1] + offsets[q, 1] - origin[1]) / spacing[1]
            z = (centres[m, 2] + offsets[q, 2] - origin[2]) / spacing[2]
            if not (0 <= x <= nx - 1 and 0 <= y <= ny - 1 and 0 <= z <= nz - 1):
                continue
            if flagged(seen, x, y, z):
                maxima[m] = max(maxima[m], trilinear(intensities, x, y, z))
    return maxima


def axis_profile(
    volume: Volume, axis: Axis, start: float, stop: float, parameters: TipParameters
) -> AxisProfile:
    """Sample the intensity along an axis.

    Parameters
    ----------
    volume
        Volume to sample.
    axis
        Axis in W, in m.
    start, stop
        Abscissae between which to sample, in m.
    parameters
        Step, and radii of the tube and the background.
    """
    a = np.arange(start, stop + parameters.step, parameters.step)
    p_W = axis.position(a)
    p_P = acquired_from(volume, p_W)
    # One plane across the needle serves all points, as the curve bends little.
    along = volume.X_WP.rotation().matrix().T @ axis.direction
    across = np.linalg.svd(along[np.newaxis])[2][1:]
    hexagon = np.array([[np.cos(t), np.sin(t)] for t in np.arange(6) * np.pi / 3])
    half = 0.5 * hexagon @ np.array([[0.866, 0.5], [-0.5, 0.866]])
    disc = parameters.tube_radius * np.vstack([np.zeros((1, 2)), half, hexagon]) @ across
    octagon = np.array([[np.cos(t), np.sin(t)] for t in np.arange(8) * np.pi / 4])
    ring = parameters.background_radius * octagon @ across
    centres = np.concatenate([p_P[np.newaxis], p_P + ring[:, np.newaxis]])
    maxima = _tube_maxima(
        volume.intensities,
        volume.seen,
        volume.origin,
        volume.spacing,
        centres.reshape(-1, 3),
        disc,
    ).reshape(len(centres), len(a))
    inside = np.all((p_P >= volume.origin) & (p_P <= volume.upper), axis=1)
    if volume.motion is not None:
        inside &= volume.motion.geometry.contains(p_P)
    # Positions beside the axis that fall outside the sector say nothing about the background.
    beside = np.where(maxima[1:] >= 0, maxima[1:], np.nan)
    beside[0, np.all(np.isnan(beside), axis=0)] = 0.0
    return AxisProfile(
        a,
        p_W,
        maxima[0].clip(0) * volume.decibels_per_level,
        np.nanmedian(beside, axis=0) * volume.decibels_per_level,
        inside & (maxima[0] >= 0),
        needle_blur(volume, p_P, along, parameters.beam_width),
        parameters.contrast,
    )


def most_evident_stretch(
    contrast: NDArray[np.float64],
    seen: NDArray[np.bool_],
    *,
    step: float,
    neutral: float,
    max_evidence: float,
) -> tuple[int, int, float]:
    """Find the stretch along an axis over which the evidence for a needle is largest.

    A sample that stands out from the background by more than ``neutral`` is evidence for the
    needle, and any other one is evidence against it. An unseen sample counts like one that does not
    stand out at all. A gap is bridged if the evidence beyond it outweighs it.

    Parameters
    ----------
    contrast
        (m,) levels above the background, in dB, at evenly spaced samples.
    seen
        (m,) flags of the samples in the field of view.
    step
        Distance between samples, in m.
    neutral
        Contrast that is evidence neither for nor against a needle, in dB.
    max_evidence
        Largest evidence of one sample, in dB.

    Returns
    -------
    Index of the first sample, index of the last sample, and integral of the evidence in dB m. The
    last index is below the first if there is no evidence for a needle.
    """
    evidence = np.where(seen, np.clip(contrast - neutral, -neutral, max_evidence), -neutral)
    (first,), (last,), _ = best_stretches(evidence[np.newaxis])
    return first, last, float(evidence[first : last + 1].sum()) * step


def find_extent(
    profile: AxisProfile, parameters: TipParameters, expected: float = -np.inf
) -> NeedleExtent | NotFound:
    """Find the ends of a needle along its axis (Chatelain 2013, end of section II-D).

    The needle is the `most_evident_stretch`. It bridges gaps, as a needle fades unless a scan line
    meets it at a right angle.

    The tip follows from the point at which the needle's blurred end is lost in the background, D dB
    below the end's own level. A mirror-like edge blurred by a Gaussian beam of standard deviation
    sigma has the amplitude Phi(-x / sigma) at x beyond the tip, and a rough one the intensity
    Phi(-sqrt(2) x / sigma), so x follows from D. The drop to half the
    amplitude (6 dB), which lies at the tip itself, is less reliable: the needle's speckle and the
    flank of its mirror-like echo have drops of their own.

    Parameters
    ----------
    profile
        Profile of the intensity along the axis.
    parameters
        Thresholds.
    expected
        Abscissa at which the tip is expected, in m. A needle that stands out less far may go on
        faintly; see `faint_part`.

    Returns
    -------
    The extent, or a `NotFound` with the reason why there is none.
    """
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
    tip, end_std, hidden, hidden_std = _tip(profile, contrast, (first, last), parameters)
    width = _width_at(profile, tip, parameters)
    faint, continues = faint_part(profile.a, contrast, profile.seen, tip, expected, width)
    if faint > 0:
        end_std, hidden, hidden_std = FAINT_STD, 0.0, 0.0
    tip += faint + hidden
    # Outside the tissue nothing scatters, so a needle that enters it in view comes from nowhere.
    around = uniform_filter1d(profile.background, round(parameters.end_length / step))
    empty = around < np.median(around[first : last + 1]) - _EMPTY
    unseen = np.flatnonzero(~profile.seen[:first] | empty[:first])
    beyond = np.searchsorted(profile.a, max(profile.a[last], tip) + parameters.smoothing)
    return NeedleExtent(
        start=float(profile.a[first]),
        tip=tip,
        entered=float(profile.a[unseen[-1]]) if len(unseen) else -np.inf,
        leaves=bool(beyond >= len(profile.a) or not profile.seen[beyond]),
        evidence=evidence,
        tip_std=float(np.hypot(end_std, hidden_std)),
        end_std=end_std,
        faint=faint,
        continues=continues,
    )


def _tip(
    profile: AxisProfile,
    contrast: NDArray[np.float64],
    needle: tuple[int, int],
    parameters: TipParameters,
) -> tuple[float, float, float, float]:
    """Return the abscissa of the end, its standard deviation, and `hidden_length`, in m.

    A needle that stands out far and ends abruptly ends where it seems to. One that is faint or
    fades may continue unseen. The ``needle`` is that between two indices if nothing stands out as
    an end must.
    """
    a, step = profile.a, parameters.step

    def stretch(contrast: NDArray[np.float64], seen: NDArray[np.bool_], neutral: float) -> Any:
        return most_evident_stretch(
            contrast, seen, step=step, neutral=neutral, max_evidence=neutral
        )

    from_start = profile.seen & (np.arange(len(a)) >= needle[0])
    first, last, _ = stretch(contrast, from_start, parameters.min_end_contrast)
    first, last = (first, last) if last >= first else needle
    near = contrast[max(first, last - round(2 * parameters.end_length / step)) : last + 1]
    threshold = float(
        np.clip(np.median(near) / 2, parameters.min_end_contrast, parameters.end_contrast)
    )
    inside = contrast[first : last + 1]
    bright = stretch(inside, np.ones_like(inside, dtype=bool), threshold)[1]
    end = first + bright if bright >= 0 else last
    begin = max(first, int(np.searchsorted(a, a[end] - parameters.end_length)))
    top = float(contrast[begin : end + 1].max())
    lost = float(a[end])
    if end + 1 < len(a) and contrast[end + 1] < threshold < contrast[end]:
        lost = float(np.interp(threshold, contrast[[end + 1, end]], a[[end + 1, end]]))
    sigma = _width_at(profile, lost, parameters) / FWHM_PER_SIGMA
    blurred = contrast[int(np.searchsorted(a, lost - 2 * sigma)) : end + 1]
    drop = float(blurred.max(initial=threshold)) - threshold
    doubt = _FADED * max(1 - drop / _ABRUPT_DROP, 0) + _FAINT * max(1 - top / _CLEAR_CONTRAST, 0)
    tip = lost - sigma * _blurred_length(top, max(top - threshold, 0.1))
    faint = inside[: end + 1 - first] < min(parameters.min_end_contrast, float(np.median(inside)))
    hidden, hidden_std = hidden_length(faint, step)
    return tip, _END_SHARE * sigma * float(np.exp(doubt)), hidden, hidden_std


def _width_at(profile: AxisProfile, a: float, parameters: TipParameters) -> float:
    """Return the width of the beam along the needle at an abscissa, in m."""
    if profile.beam_width is None:
        return parameters.beam_width or _TYPICAL_WIDTH
    return float(np.interp(a, profile.a, profile.beam_width))


def _blurred_length(top: float, fallen: float) -> float:
    """Return the distance from an end to where it has fallen by some dB, relative to the blur.

    The amplitudes of a mirror-like end add up, and the intensities of a rough one, whose points
    have random phases. Mirror-like ends are much the brighter, so the contrast ``top`` in dB tells
    which is which.
    """
    amplitude = -float(ndtri(10 ** (-fallen / 20)))
    intensity = -float(ndtri(min(10 ** (-fallen / 10), 0.5))) / np.sqrt(2)
    share = float(np.clip((top - _ROUGH_CONTRAST) / (_MIRROR_CONTRAST - _ROUGH_CONTRAST), 0, 1))
    return share * amplitude + (1 - share) * intensity
