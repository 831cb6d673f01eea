"""Motion of speckle from one frame to another, by normalised cross-correlation."""

import numpy as np


def _parabola(values):
    """Offset of a peak from the middle of three values."""
    left, middle, right = values
    return 0.5 * (left - right) / (left - 2 * middle + right)


def speckle_motion(before, after, line, sample, half=(6, 24), reach=(8, 40), start=(0, 0)):
    """Lines and samples by which the speckle around a place has moved, and the peak's height.

    before, after: (lines, samples) amplitudes. half: half size of the window. reach: half size of
    the search about ``start``.
    """
    a, b = half
    window = before[line - a : line + a + 1, sample - b : sample + b + 1]
    window = (window - window.mean()) / window.std()
    heights = np.empty((2 * reach[0] + 1, 2 * reach[1] + 1))
    for i, j in np.ndindex(heights.shape):
        middle = line + start[0] + i - reach[0], sample + start[1] + j - reach[1]
        other = after[middle[0] - a : middle[0] + a + 1, middle[1] - b : middle[1] + b + 1]
        heights[i, j] = (window * (other - other.mean())).mean() / other.std()
    i, j = np.unravel_index(heights.argmax(), heights.shape)
    assert 0 < i < heights.shape[0] - 1
    assert 0 < j < heights.shape[1] - 1
    lines = start[0] + i - reach[0] + _parabola(heights[i - 1 : i + 2, j])
    samples = start[1] + j - reach[1] + _parabola(heights[i, j - 1 : j + 2])
    return lines, samples, heights[i, j]
