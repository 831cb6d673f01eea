"""Ends of a needle as published: where the intensity along its axis drops for good."""

import numpy as np
from numpy.typing import NDArray


def intensity_drops(
    bright: NDArray[np.float64], middle: float, max_gap: float
) -> tuple[float, float]:
    """Return the ends of the bright stretch around a point of an axis; small gaps do not end it.

    Chatelain 2013, end of section II-D, and Zhao 2012, section 2.1.2.

    Parameters
    ----------
    bright
        (m,) abscissae of the samples that are as bright as the needle, in m.
    middle
        Abscissa of a point on the needle, in m.
    max_gap
        Largest gap that does not end the needle, in m.

    Returns
    -------
    start, tip
        Abscissae of the first and last bright sample, in m.
    """
    start, tip = (_end(bright, middle, side, max_gap) for side in (-1, 1))
    return start, tip


def _end(bright: NDArray[np.float64], middle: float, side: int, max_gap: float) -> float:
    """Return the last abscissa to a side of the middle that no gap separates from it."""
    away = np.sort(side * (bright - middle))
    away = np.concatenate([[0.0], away[away > 0]])
    last = np.flatnonzero(np.append(np.diff(away), np.inf) > max_gap)[0]
    return middle + side * float(away[last])
