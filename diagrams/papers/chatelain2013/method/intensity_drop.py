"""Ends of a needle as published: where the intensity along its axis drops for good."""

import numpy as np
from numpy.typing import NDArray


def intensity_drops(
    bright: NDArray[np.float64], middle: float, max_gap: float
) -> tuple[float, float]:
    """Return the ends of the bright stretch around ``middle``; no gap up to ``max_gap`` ends it.

    ``bright`` holds the ascending abscissae of the bright samples of a profile. All lengths are in
    m.
    """
    start, tip = (_end(bright, middle, side, max_gap) for side in (-1, 1))
    return start, tip


def _end(bright: NDArray[np.float64], middle: float, side: int, max_gap: float) -> float:
    """Return the last abscissa to a side of the middle that no gap separates from it."""
    away = np.sort(side * (bright - middle))
    away = np.concatenate([[0.0], away[away > 0]])
    last = np.flatnonzero(np.append(np.diff(away), np.inf) > max_gap)[0]
    return middle + side * float(away[last])
