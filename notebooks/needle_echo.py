"""Visibility of a needle in a sweep."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sonoservo.systems.signals.sweep import Sweep
from sonoservo.systems.ultrasound.imaging import ImagingParameters

_STEP = 0.1e-3
_NEAR = 1e-3
_FAR = 12e-3
_VISIBLE_DB = 12.0
_THICKNESS_DB = -20.0


@dataclass(frozen=True, eq=False)
class NeedleEchoFigures:
    """Appearance of a straight needle in a sweep.

    Parameters
    ----------
    peak_db
        Highest level on the needle relative to the tissue's mean, in dB. It is limited by the
        highest grey level.
    visible_length
        Length of the needle whose level, averaged over 1 mm, is at least 12 dB above the tissue's,
        in m.
    thickness
        Thickness of the echo where the needle is brightest, in m: the distance between the first
        and the last point less than 20 dB below the peak, across the needle in the plane of needle
        and beam. NaN if the tissue itself is as bright as that.
    distance, level_db
        (n,) distances along the needle from its first end in m, and levels there in dB, averaged
        over 1 mm; NaN outside the sector.
    """

    peak_db: float
    visible_length: float
    thickness: float
    distance: NDArray[np.float64]
    level_db: NDArray[np.float64]


def measure_needle_echo(
    sweep: Sweep, shaft: NDArray[np.float64], imaging: ImagingParameters
) -> NeedleEchoFigures:
    """Measure the appearance of a needle in a sweep of a probe at rest.

    Parameters
    ----------
    sweep
        Sweep to measure.
    shaft
        (2, 3) ends of the needle in P, in m.
    imaging
        Settings with which the sweep was acquired.
    """
    length = float(np.linalg.norm(shaft[1] - shaft[0]))
    along = (shaft[1] - shaft[0]) / length
    depth = np.array([0, 1.0, 0])
    normal = depth - (depth @ along) * along
    normal /= np.linalg.norm(normal)
    distance = np.arange(0, length, _STEP)
    axis = shaft[0] + distance[:, np.newaxis] * along
    offsets = np.arange(-_NEAR, _NEAR + _STEP, _STEP)[:, np.newaxis] * normal
    grey = sweep.sample(axis[:, np.newaxis] + offsets, outside=-np.inf)
    level = sweep.decibels_per_level * (grey - imaging.tissue_grey)
    crest = level.max(axis=1)
    shown = np.isfinite(crest)
    smooth = uniform_filter1d(np.where(shown, crest, 0), round(1e-3 / _STEP))
    smooth[~shown] = np.nan
    brightest = int(crest.argmax())
    across = np.arange(-_FAR, _FAR, _STEP)
    grey = sweep.sample(axis[brightest] + across[:, np.newaxis] * normal, outside=None)
    peak = crest[brightest]
    bright = np.flatnonzero(
        sweep.decibels_per_level * (grey - imaging.tissue_grey) > peak + _THICKNESS_DB
    )
    thickness = float(_STEP * (bright[-1] - bright[0] + 1))
    return NeedleEchoFigures(
        peak_db=float(peak),
        visible_length=float(_STEP * np.sum(smooth >= _VISIBLE_DB)),
        thickness=thickness if peak + _THICKNESS_DB > 0 else float("nan"),
        distance=distance,
        level_db=smooth,
    )
