"""Path of a bevelled needle modelled as an elastic beam in tissue that holds it and yields to it.

Unlike `SteeredPath`, the shaft does not follow the tip. The needle is a beam of stiffness EI,
clamped in its template at x = 0 and held by the tissue, an elastic foundation of stiffness k
(Glozman and Shoham 2007; Roesthuis et al. 2012). The foundation is at rest along the cut. With
every step, the tip, which lies at the end of its cut, cuts on along its own tangent and a bevel's
slope aside. The shaft, which presses against its cut, cuts sideways through a part of what is
between them. The deflection w and the cut c satisfy

    EI w'''' + k (w - c) = 0,    w(0) = w'(0) = 0,    w(L) = c(L),    w''(L) = 0,
    c(L + ds) = w(L) + (w'(L) +- slope) ds,    dc = (w - c) ds / yield length.

All deflections are proportional to the slope. Its value follows from a radius R: a needle of 0.1 m
that was never turned is as far aside as an arc of that radius.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from sonoservo.systems.signals.immutable import Immutable, seal

Floats = NDArray[np.float64]

FREE_LENGTH = 0.01  # length of the needle in m between the template's clamp and the tissue
_JUDGED = 0.1  # length of the needle in m by whose deflection its radius is told

_STEP = 1e-3
"""Length in m by which the needle advances at a time, and between the nodes of the beam."""

STIFFNESS = 0.02
"""Bending stiffness EI of an 18 G needle of steel, in N m^2: 200 GPa and a wall of 0.2 mm."""

FOUNDATION = 2e4  # stiffness k of the tissue around it in N/m^2: some 20 kPa, as of muscle

YIELD_LENGTH = 0.1
"""Advance in m in which the shaft cuts sideways through 1 - 1/e of what holds it; chosen."""


@dataclass(frozen=True, eq=False)
class BeamPath(Immutable):
    """Path of an elastic needle, in coordinates along the aim, up and beside."""

    radius: float  # of the arc that is as far aside after 0.1 m unturned, in m
    roll: float  # direction of the first bend, from up towards beside, in rad
    angle: float  # of the template to the aim, towards the bend, in rad
    rotations: tuple[float, ...]  # depths of turns by 180 deg, in m, ascending
    depth: float  # largest, in m

    def positions(self, distances: Floats, cut: tuple[Floats, Floats] | None = None) -> Floats:
        """Return the (k, 3) positions of points on the shaft, in m."""
        count = int(np.ceil(self.depth / _STEP)) + 3
        long = round(_JUDGED / _STEP)
        scale = _JUDGED**2 / (2 * self.radius) / _deflections((), long + 1)[long, long]
        table = scale * _deflections(self.rotations, count)
        number = np.clip(distances[-1] / _STEP, 0, len(table) - 1)
        low = min(int(number), len(table) - 2)
        share = number - low
        nodes = _STEP * np.arange(table.shape[1])
        aside = np.interp(distances, nodes, (1 - share) * table[low] + share * table[low + 1])
        aside = aside + np.tan(self.angle) * distances
        return np.stack([distances, np.cos(self.roll) * aside, np.sin(self.roll) * aside], axis=-1)

    def length_at(self, depth: float) -> float:
        """Return the length of the shaft down to a depth, both in m; deflections are small."""
        return max(depth, 0.0)

    @property
    def direction(self) -> Floats:
        """(3,) unit vector of the first direction, in coordinates along the aim, up and beside."""
        aside = np.sin(self.angle)
        return np.array([np.cos(self.angle), aside * np.cos(self.roll), aside * np.sin(self.roll)])


@lru_cache(maxsize=8)
def _deflections(rotations: tuple[float, ...], count: int) -> Floats:
    """Return (n, n) deflections in m at each node, by the tip's node (row), for slope 1."""
    free = round(FREE_LENGTH / _STEP)
    found, cut = np.zeros((count, count)), np.zeros(free + count)
    nodes = np.arange(count)
    for tip in range(count):
        last = free + tip
        w = _bent(cut[: last + 1], free)
        # The bending moment falls evenly to zero at the tip.
        tangent = (w[-1] - w[-2] + (w[-1] - 2 * w[-2] + w[-3]) / 6) / _STEP
        found[tip, : tip + 1] = w[free:]
        found[tip, tip:] = w[-1] + tangent * _STEP * (nodes[tip:] - tip)
        cut[: last + 1] += (w - cut[: last + 1]) * _STEP / YIELD_LENGTH
        if tip + 1 < count:
            sign = (-1.0) ** np.searchsorted(rotations, tip * _STEP, side="right")
            cut[last + 1] = w[-1] + (tangent + sign) * _STEP
    return seal(found)


def _bent(cut: Floats, free: int) -> Floats:
    """Return (n,) deflections from a clamp at the first node, of which ``free`` lie outside."""
    n = len(cut)
    # The energy of bending is the sum of squared second differences. Mirrored behind the first
    # node, the beam is clamped there; at the tip it may turn.
    stiffness = STIFFNESS / _STEP**3
    foundation = np.where(np.arange(1, n - 1) < free, 0.0, FOUNDATION * _STEP)
    bands = np.repeat([[1.0], [-4.0], [6.0]], n - 2, axis=1)
    bands[2, 0] += 1
    bands[2, -1] -= 1
    bands = stiffness * bands
    bands[2] += foundation
    load = foundation * cut[1:-1]
    load[-1] += 2 * stiffness * cut[-1]
    if n > 3:
        load[-2] -= stiffness * cut[-1]
    return np.concatenate([[0.0], solveh_banded(bands[-(n - 2) :], load), cut[-1:]])
