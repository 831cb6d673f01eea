"""Length of a true needle that stands out in a volume, whatever a tracker makes of it."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

STANDS_OUT_DB = 6.0  # level over the tissue from which a needle stands out, in dB

_STEP, _AVERAGED = 0.5e-3, 3e-3
"""Distance between samples along the needle, and length of the average that takes out speckle, in
m."""

_NEAR = 0.5e-3 * np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
"""Offsets across the needle at which its echo is sampled, in m."""

_TURNS = np.arange(8) * np.pi / 4
_AROUND = np.concatenate(
    [r * np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1) for r in (4e-3, 5e-3, 6e-3)]
)
"""Offsets across the needle at which the tissue is sampled, in m."""

_DEPTHS = np.linspace(0.92, 1.08, 17)
"""Factors of the depth, by which a wrong speed of sound displaces the needle's echo."""


def conspicuous_length(volume: Volume, points: Floats) -> float:
    """Return the length of a needle that stands 6 dB or more over the tissue around it, in m.

    Echo and tissue are mean grey levels, within 0.7 mm and from 4 to 6 mm of the needle, over 3 mm
    along it. The depth is scaled by up to 8 % to where the needle is brightest, as an image made
    with a wrong speed of sound shows it there.

    Parameters
    ----------
    volume
        Volume that shows the needle.
    points
        (n, 3) positions along the needle from entry to tip, where the volume would show them in P
        if its depth were right, in m.

    Returns
    -------
    Length in m, to 0.5 mm; 0 for a needle outside the field of view.
    """
    ends = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    samples = np.arange(_STEP / 2, ends[-1], _STEP)
    if len(samples) < 2:
        return 0.0
    axis = np.stack([np.interp(samples, ends, each) for each in points.T], axis=1)
    scaled = [axis * [1.0, factor, 1.0] for factor in _DEPTHS]
    axis = max(scaled, key=lambda each: float(volume.sample(_beside(each, _NEAR)).mean()))
    shown = volume.sees(axis)
    around = volume.sample(beside := _beside(axis, _AROUND))
    count = np.count_nonzero(volume.sees(beside), axis=0)
    echo = volume.sample(_beside(axis, _NEAR)).mean(axis=0)
    tissue = around.sum(axis=0) / np.maximum(count, 1)
    over = volume.decibels_per_level * uniform_filter1d(echo - tissue, round(_AVERAGED / _STEP))
    return _STEP * np.count_nonzero(shown & (count > 0) & (over >= STANDS_OUT_DB))


def _beside(axis: Floats, offsets: Floats) -> Floats:
    """Return (m, n, 3) positions beside a needle at (m, 2) offsets across it."""
    k = np.gradient(axis, axis=0)
    k /= np.linalg.norm(k, axis=1, keepdims=True)
    # Any normal will do: the offsets surround the needle.
    least = np.eye(3)[int(np.abs(k).mean(axis=0).argmin())]
    aside = np.cross(k, least)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    up = np.cross(k, aside)
    u, v = offsets.T[..., np.newaxis, np.newaxis]
    return np.asarray(axis + u * aside + v * up)
