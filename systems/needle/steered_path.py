"""Path that a bevelled needle cuts while it is pushed, turned and withdrawn.

The model is the bicycle model of Webster et al. 2006 in space. The tip bends towards the side to
which its bevel is turned. With the tangent d, two axes u and v that do not twist about it, the
bevel turned by the angle rho, and the curvature kappa = 1 / R,

    d' = kappa (cos(rho) u + sin(rho) v),  u' = -kappa cos(rho) d,  v' = -kappa sin(rho) d.

The path is a chain of arcs with constant kappa and rho. If the bevel is turned by 180 deg, kappa
changes its sign; `bicycle_paths.deflections` is this case in closed form. A needle that is
withdrawn goes back along its path. Pushed in again, it cuts a new path from there.
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from sonoservo.systems.signals.immutable import Immutable

Floats = NDArray[np.float64]
Arcs = tuple[Floats, Floats, Floats]
"""Lengths in m, angles of the bevel in rad and curvatures in 1/m of the arcs."""

WANDER_STEP = 0.5e-3  # path length in m over which a wandering curvature is constant


def cut_arcs(depths: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Return (m,) lengths in m and bevel angles in rad of the arcs at the end of a history."""
    # A stretch of the path exists if the tip passed it on its way in and has not been shallower
    # since. Its length is the amount that a step adds to the smallest depth from then on.
    least = np.minimum.accumulate(np.maximum(depths, 0.0)[::-1])[::-1]
    lengths = np.diff(least)
    added = lengths > 0
    lengths, angles = lengths[added], 0.5 * (turns[1:] + turns[:-1])[added]
    if not lengths.size:
        return lengths, angles
    # Stretches cut with the bevel at rest form one arc.
    first = np.flatnonzero(np.append(True, np.diff(angles) != 0))
    return np.add.reduceat(lengths, first), angles[first]


def draw_wander(length: float, std: float, scale: float, rng: np.random.Generator) -> Floats:
    """Draw the curvature relative to its mean, a value for each `WANDER_STEP` of a path."""
    sigma = scale / WANDER_STEP
    count = len(np.arange(0, length, WANDER_STEP))
    noise = gaussian_filter1d(rng.normal(size=count + 8 * int(sigma)), sigma)
    noise *= np.sqrt(2 * np.sqrt(np.pi) * sigma)  # to a variance of 1
    return 1 + std * noise[4 * int(sigma) :][:count]


@dataclass(frozen=True, eq=False)
class SteeredPath(Immutable):
    """Path of a bevelled tip from the entry, in coordinates along the aim, up and beside."""

    radius: float  # of the arcs, in m
    roll: float = 0.0  # direction of the first bend, from up towards beside, in rad
    angle: float = 0.0  # of the first direction to the aim, towards the bend, in rad
    rotations: tuple[float, ...] = ()  # depths along the aim of turns by 180 deg, in m, ascending
    wander: Floats = field(default_factory=lambda: np.zeros(0))
    twist: float = 0.0  # turn of the bend from one step of ``wander`` to the next, in rad/m
    turn_errors: tuple[float, ...] = ()  # of the rotations, in rad; empty for none

    def positions(self, distances: Floats, cut: tuple[Floats, Floats] | None = None) -> Floats:
        """Return (k, 3) coordinates in m along the aimed direction, up and beside."""
        found: Floats = positions(*self._arcs(np.array(self.rotations), cut)[0], distances)
        return found @ self._first_axes if self.angle else found

    def length_at(self, depth: float) -> float:
        """Return the path length in m down to a depth along the aim, or infinity."""
        if depth <= 0:
            return 0.0
        before = [each for each in self.rotations if each < depth]
        _, reached = self._arcs(np.array([*before, depth]), None)
        return float(reached[-1])

    @property
    def direction(self) -> Floats:
        """(3,) unit vector of the first direction, in coordinates along the aim, up and beside."""
        return self._first_axes[0]

    @property
    def _first_axes(self) -> Floats:
        """(3, 3) rows d, u, v at the entry."""
        return np.array(_turned(np.eye(3), self.roll, self.angle))

    def _arcs(self, turns: Floats, cut: tuple[Floats, Floats] | None) -> tuple[Arcs, Floats]:
        """Return the arcs, and the path length down to each depth at which the bevel is turned."""
        lengths, angles = (np.array([np.inf]), np.zeros(1)) if cut is None else cut
        angles = self.roll + angles
        curvatures = np.full(len(lengths), 1 / self.radius)
        if self.wander.size:
            ends = np.cumsum(lengths)
            steps = WANDER_STEP * np.arange(1, len(self.wander))
            edges = np.union1d(ends, steps[steps < ends[-1]])
            starts = np.append(0.0, edges[:-1])
            lengths, angles = edges - starts, angles[np.searchsorted(ends, edges)]
            angles = angles + self.twist * starts
            curvatures = self.wander[np.searchsorted(steps, starts, side="right")] / self.radius
        if not turns.size:
            return (lengths, angles, curvatures), turns
        axis = np.ascontiguousarray(self._first_axes[:, 0])
        errors = np.zeros(len(turns))
        known = self.turn_errors[: len(turns)]
        errors[: len(known)] = known
        *arcs, reached = turn_at_depths(lengths, angles, curvatures, turns, errors, axis)
        return (arcs[0], arcs[1], arcs[2]), reached


@njit(cache=True, nogil=True)
def positions(lengths, angles, curvatures, distances):  # type: ignore[no-untyped-def]
    """Return (k, 3) coordinates in m along the first d, u and v; the last arc goes on."""
    found = np.empty((len(distances), 3))
    p = np.zeros(3)
    axes = np.eye(3)  # rows d, u, v
    start = 0.0
    k = 0
    for i in range(len(lengths)):
        curvature = curvatures[i]
        cosine, sine = np.cos(angles[i]), np.sin(angles[i])
        d = axes[0].copy()
        normal = cosine * axes[1] + sine * axes[2]
        last = i == len(lengths) - 1
        while k < len(distances) and (last or distances[k] < start + lengths[i]):
            angle = (distances[k] - start) * curvature
            found[k] = p + (np.sin(angle) * d + (1 - np.cos(angle)) * normal) / curvature
            k += 1
        if last:
            break
        angle = lengths[i] * curvature
        p = p + (np.sin(angle) * d + (1 - np.cos(angle)) * normal) / curvature
        axes = _turned(axes, angles[i], angle)
        start += lengths[i]
    return found


@njit(cache=True, nogil=True)
def turn_at_depths(lengths, angles, curvatures, depths, errors, axis):  # type: ignore[no-untyped-def]
    """Split arcs at depths where the bevel turns; return them, and the depths' lengths."""
    most = len(lengths) + len(depths)
    new_lengths, new_angles, new_curvatures = np.empty(most), np.empty(most), np.empty(most)
    reached = np.full(len(depths), np.inf)
    axes = np.eye(3)
    count, k, depth, length, sign, excess = 0, 0, 0.0, 0.0, 1.0, 0.0
    for i in range(len(lengths)):
        left = lengths[i]
        while True:
            curvature = sign * curvatures[i]
            roll = angles[i] + excess
            normal = np.cos(roll) * axes[1] + np.sin(roll) * axes[2]
            forward, aside = np.dot(axes[0], axis), np.dot(normal, axis)
            to_turn = np.inf
            if k < len(depths):
                to_turn = _length_of_rise(forward, aside, curvature, depths[k] - depth)
            piece = min(left, to_turn)
            new_lengths[count], new_angles[count] = piece, roll
            new_curvatures[count] = curvature
            count += 1
            if piece == np.inf:
                break
            angle = piece * curvature
            depth += (np.sin(angle) * forward + (1 - np.cos(angle)) * aside) / curvature
            length += piece
            axes = _turned(axes, roll, angle)
            if to_turn > left:
                break
            reached[k] = length
            excess += errors[k]
            k += 1
            sign = -sign
            left -= piece
    return new_lengths[:count], new_angles[:count], new_curvatures[:count], reached


@njit(cache=True, nogil=True)
def _turned(axes, roll, angle):  # type: ignore[no-untyped-def]
    """Return the rows d, u, v after an arc of an angle in rad, towards the side of the bevel."""
    cosine, sine = np.cos(roll), np.sin(roll)
    d = axes[0]
    normal = cosine * axes[1] + sine * axes[2]
    forward, aside = np.sin(angle), 1 - np.cos(angle)
    turned = axes.copy()
    turned[0] = np.cos(angle) * d + forward * normal
    bent = -forward * d - aside * normal  # change of the normal
    turned[1] += cosine * bent
    turned[2] += sine * bent
    return turned


@njit(cache=True, nogil=True)
def _length_of_rise(forward, aside, curvature, rise):  # type: ignore[no-untyped-def]
    """Return the arc length in m that rises by ``rise`` along an axis, or infinity.

    With the angle x = kappa s, the tangent's component a and the normal's component b, it solves
    a sin(x) + b (1 - cos(x)) = kappa rise, which is sin(x - phi) = (kappa rise - b) / hypot(a, b).
    """
    sine = (curvature * rise - aside) / np.hypot(forward, aside)
    if forward <= 0 or abs(sine) > 1:
        return np.inf
    return max((np.arctan2(aside, forward) + np.arcsin(sine)) / curvature, 0.0)
