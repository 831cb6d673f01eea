"""End of a needle that goes on, faintly, beyond where it stands out."""

import numpy as np
from numpy.typing import NDArray

_CONTRAST, _MOST = 1.7, 2.0
"""Contrast halfway between none and that of a faint needle, and largest evidence for or against
one of a sample, in dB."""

_SURE = 5.0
"""Evidence from which on a faint part is more than speckle, in dB times the beam's width along the
needle. Along lines through tissue alone, it is exceeded in one of a hundred."""

FAINT_STD = 3e-3
"""Standard deviation of a faint end, in m."""


def faint_length(contrast: NDArray[np.float64], step: float, beam_width: float) -> float:
    """Return by how much a needle goes on beyond the end that stands out, in m; 0 if it does not.

    Speckle averages out over a length, so a part of a needle that no single sample shows is evident
    as a whole.

    Parameters
    ----------
    contrast
        (m,) levels above the background, in dB, from that end to where the axis leaves the view.
    step
        Distance between samples, in m.
    beam_width
        Width of the beam along the needle, in m, over which speckle is alike.
    """
    evidence = step * np.cumsum(np.clip(contrast - _CONTRAST, -_MOST, _MOST))
    if evidence.max(initial=0.0) < _SURE * beam_width:
        return 0.0
    return step * (1 + int(evidence.argmax()))
