"""Length by which a needle that is seen with gaps goes on beyond its visible end."""

import numpy as np
from numpy.typing import NDArray


def hidden_length(faint: NDArray[np.bool_], step: float) -> tuple[float, float]:
    """Return by how much a needle goes on beyond its visible end, and the standard deviation, in m.

    A needle that is seen with gaps probably ends in one. A point chosen at random lies in a gap of
    length l with probability l / L, and if it does, anywhere in it. So on average the sum of
    l^2 / 2L is hidden, and the mean square is the sum of l^3 / 3L.

    Parameters
    ----------
    faint
        (m,) flags of the samples of a needle's visible length L that do not stand out.
    step
        Distance between samples, in m.
    """
    edges = np.flatnonzero(np.diff(faint.astype(int), prepend=0, append=0))
    gaps, length = step * (edges[1::2] - edges[::2]), step * len(faint)
    mean = float(np.sum(gaps**2)) / (2 * length)
    return mean, float(np.sqrt(max(np.sum(gaps**3) / (3 * length) - mean**2, 0.0)))
