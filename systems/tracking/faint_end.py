"""Whether a needle goes on, faintly, beyond where it stands out."""

import numpy as np
from numpy.typing import NDArray

FAINT_STD = 4e-3
"""Standard deviation of a faint end, in m."""

_CONTRAST, _MOST = 1.7, 2.0
"""Contrast halfway between none and that of a faint needle, and largest evidence of a sample for or
against one, in dB."""

_SURE = 5.0
"""Evidence from which on a faint part is more than speckle, in dB times the beam's width along the
needle. Along lines through tissue alone, it is exceeded in one of a hundred."""

_SHORT = 3e-3
"""Distance between the visible end and the expected tip within which the end may be the tip, and
from the expected tip to the farthest faint end, in m."""

_LENGTH, _MEAN = 10e-3, 1.35
"""Length in m over which the mean contrast tells whether there is a needle, and that mean in dB."""


def faint_part(
    a: NDArray[np.float64],
    contrast: NDArray[np.float64],
    seen: NDArray[np.bool_],
    end: float,
    expected: float,
    beam_width: float,
) -> tuple[float, bool]:
    """Return by how much a needle goes on beyond its visible end, in m, and if it may go further.

    Speckle averages out over a length, so a part of a needle that no single sample shows is evident
    as a whole. It may go further if 1 cm or more between its end and the expected tip is
    brighter than tissue, or if it is followed to a little beyond that tip, where the search ends.

    Parameters
    ----------
    a, contrast, seen
        (m,) abscissae in m, evenly spaced, levels above the background in dB, and flags of the
        samples in the field of view.
    end, expected
        Abscissae of the visible end and of the expected tip, in m.
    beam_width
        Width of the beam along the needle, in m, over which speckle is alike.
    """
    if end >= expected - _SHORT:
        return 0.0, False
    beyond = (a > end) & (a <= expected + _SHORT)
    beyond &= np.logical_and.accumulate(seen | (a <= end))
    further, step = contrast[beyond], float(a[1] - a[0])
    evidence = step * np.cumsum(np.clip(further - _CONTRAST, -_MOST, _MOST))
    faint = 0
    if evidence.max(initial=0.0) >= _SURE * beam_width:
        faint = 1 + int(evidence.argmax())
    # The blurred end of what stands out is no part of the rest.
    begin = faint or round(beam_width / step)
    rest = further[begin : np.count_nonzero(beyond & (a <= expected))]
    most = _CONTRAST + _MOST
    bright = step * len(rest) >= _LENGTH and np.clip(rest, -most, most).mean() > _MEAN
    endless = faint == np.count_nonzero(a > end) - np.count_nonzero(a > expected + _SHORT)
    return step * faint, bool(bright or (faint > 0 and endless))
