"""The path that a bevelled needle cuts while a hand pushes, turns and withdraws it.

The tip bends towards where its bevel is turned, with constant curvature: the bicycle model of
Webster et al. 2006 in space, of which `BicyclePath` is the case of a bevel turned by 180 deg. With
the tangent d and two axes u, v that do not twist about it, and the bevel turned by the angle rho,

    d' = (cos(rho) u + sin(rho) v) / R,   u' = -cos(rho) d / R,   v' = -sin(rho) d / R.

A needle that is withdrawn goes back along its path; pushed in again it cuts a new one from there.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def cut_arcs(depths: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Return of which arcs the path consists that is there at the end of a history.

    Parameters
    ----------
    depths
        (n,) inserted lengths one after the other, in m; the last is the present one.
    turns
        (n,) angles of the bevel at the same times, in rad.

    Returns
    -------
    (m,) length of each arc from the entry to the tip in m, and (m,) its bevel's angle in rad.
    """
    # A stretch of the path is there if the tip passed it on its way in and was never shallower
    # since: what a step adds to the least depth from then on.
    least = np.minimum.accumulate(np.maximum(depths, 0.0)[::-1])[::-1]
    lengths = np.diff(least)
    added = lengths > 0
    lengths, angles = lengths[added], 0.5 * (turns[1:] + turns[:-1])[added]
    if not lengths.size:
        return lengths, angles
    # What was cut with the bevel at rest is one arc.
    first = np.flatnonzero(np.append(True, np.diff(angles) != 0))
    return np.add.reduceat(lengths, first), angles[first]


@njit(cache=True, nogil=True)
def positions(lengths, angles, curvature, distances):  # type: ignore[no-untyped-def]
    """Positions along a path of arcs.

    Parameters
    ----------
    lengths, angles
        (m,) of the arcs, in m and rad, see `cut_arcs`.
    curvature
        1 / R in 1/m.
    distances
        (k,) along the path from the entry in m, in rising order.

    Returns
    -------
    (k, 3) coordinates in m along the first d, u and v. Beyond the end the last arc goes on.
    """
    found = np.empty((len(distances), 3))
    p = np.zeros(3)
    axes = np.eye(3)  # rows d, u, v
    start = 0.0
    k = 0
    for i in range(len(lengths)):
        cosine, sine = np.cos(angles[i]), np.sin(angles[i])
        d = axes[0].copy()
        normal = cosine * axes[1] + sine * axes[2]
        last = i == len(lengths) - 1
        while k < len(distances) and (last or distances[k] < start + lengths[i]):
            angle = (distances[k] - start) * curvature
            found[k] = p + (np.sin(angle) * d + (1 - np.cos(angle)) * normal) / curvature
            k += 1
        angle = lengths[i] * curvature
        forward, aside = np.sin(angle), 1 - np.cos(angle)
        p = p + (forward * d + aside * normal) / curvature
        axes[0] = np.cos(angle) * d + forward * normal
        bent = -forward * d - aside * normal  # how the normal changes
        axes[1] += cosine * bent
        axes[2] += sine * bent
        start += lengths[i]
    return found
