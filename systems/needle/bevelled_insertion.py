"""A bevelled needle pushed through a template at constant speed, its bevel turned on the way."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RotationMatrix
from scipy.ndimage import gaussian_filter1d

from sonoservo.systems.needle.bicycle_model import BicyclePath, bicycle_step
from sonoservo.systems.needle.insertion import OUTER_DIAMETER
from sonoservo.systems.signals.bicycle_paths import require_rising
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive

_STEP = 0.5e-3
"""Between the points of a shaft, in m: off an arc of R = 0.5 m by 0.1 um."""

_BEHIND = 10e-3
"""Of the straight needle between template and first slice, in m."""


@dataclass(kw_only=True)
class BevelledInsertionParameters:
    """A needle and how it is pushed. Ranges are those of uniform distributions.

    Frame I of the insertion: Z along it, Y along the beam of a probe that steps with it, origin
    where the needle passes the first slice.

    Parameters
    ----------
    gauge
        Of the needle; sets its diameter.
    entry
        Origin of I in T, in m. Z of I is X of T, Y of I points down.
    entry_spread
        Greatest deviation from it along X and Y of I, in m.
    min_radius, greatest_radius
        Range of the radius R that the bevel cuts, in m.
    greatest_angle_deg
        The first direction is within this of Z, in the plane of deflection, which has any angle.
    rotations
        Depths along Z of I at which the hand turns the bevel by 180 deg, in m.
    curvature_wander
        Standard deviation of the curvature along the path, relative to 1 / R: uneven tissue. The
        paper's model has none.
    wander_length
        Over which the curvature changes, in m.
    depth
        Along Z of I, of the last slice, in m.
    lead
        How far the tip is ahead of the slice, in m: at the slice the beam is filled with shaft.
    speed
        In m/s.
    start
        When the tip is ``lead`` beyond the first slice, in s.
    """

    gauge: int = 18
    entry: list[float] = field(default_factory=lambda: [-0.075, 0.0, -0.030])
    entry_spread: float = 2e-3
    min_radius: float = 0.8
    greatest_radius: float = 2.4
    greatest_angle_deg: float = 2.0
    rotations: list[float] = field(default_factory=list)
    curvature_wander: float = 0.0
    wander_length: float = 0.02
    depth: float = 0.14
    lead: float = 2e-3
    speed: float = 0.01
    start: float = 0.0

    def __post_init__(self) -> None:
        allowed = ", ".join(str(gauge) for gauge in OUTER_DIAMETER)
        require(self.gauge in OUTER_DIAMETER, "gauge", self.gauge, f"one of {allowed}")
        require(len(self.entry) == 3, "entry", self.entry, "three coordinates in m")
        require_positive(depth=self.depth, speed=self.speed, wander_length=self.wander_length)
        require(self.min_radius >= 0.2, "min_radius", self.min_radius, "at least 0.2 m")
        require(
            self.greatest_radius >= self.min_radius,
            "greatest_radius",
            self.greatest_radius,
            "at least min_radius",
        )
        require(
            0 <= self.greatest_angle_deg <= 20,
            "greatest_angle_deg",
            self.greatest_angle_deg,
            "from 0 to 20 deg",
        )
        require_rising(self.rotations)
        require(
            not self.rotations or self.rotations[-1] < self.depth,
            "rotations",
            self.rotations,
            f"within the insertion, below depth ({self.depth} m)",
        )
        require_not_negative(
            entry_spread=self.entry_spread,
            curvature_wander=self.curvature_wander,
            lead=self.lead,
            start=self.start,
        )


class BevelledInsertion:
    """One insertion as a function of time.

    Parameters
    ----------
    parameters
        Of the needle and the hand.
    rng
        Draws radius, angle, plane, entry and wander.

    Attributes
    ----------
    X_TI
        Pose of I in T, at the entry that the template aims at.
    path
        The bicycle model's path without wander, from the point where the needle passes Z = 0 of I.
    """

    def __init__(self, parameters: BevelledInsertionParameters, rng: np.random.Generator) -> None:
        self._parameters = parameters
        axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        self.X_TI = RigidTransform(RotationMatrix(axes), parameters.entry)
        self.path = BicyclePath(
            radius=rng.uniform(parameters.min_radius, parameters.greatest_radius),
            angle=np.deg2rad(parameters.greatest_angle_deg) * rng.uniform(-1, 1),
            plane=rng.uniform(-np.pi, np.pi),
            rotations=tuple(parameters.rotations),
        )
        offset = np.append(parameters.entry_spread * rng.uniform(-1, 1, 2), 0.0)
        lengths = np.arange(0, 1.1 * (parameters.depth + parameters.lead) + 0.01, _STEP)
        if parameters.curvature_wander:
            points = _wandering(self.path, lengths, parameters, rng)
        else:
            points = self.path.along(lengths)
        first = points[1] - points[0]
        behind = points[0] - _BEHIND * first / np.linalg.norm(first)
        self._shaft: NDArray[np.float64] = offset + np.vstack([behind, points])

    def position(self, depth: ArrayLike) -> NDArray[np.float64]:
        """(..., 3) true path in I, in m, at depths along Z of I in m."""
        shaft, depth = self._shaft, np.asarray(depth, dtype=float)
        return np.stack([np.interp(depth, shaft[:, 2], axis) for axis in shaft.T], axis=-1)

    def depth(self, time: float) -> float:
        """Depth of the tip along Z of I, in m."""
        parameters = self._parameters
        pushed = parameters.speed * max(time - parameters.start, 0.0)
        return min(pushed, parameters.depth) + parameters.lead

    def needle(self, time: float) -> Needle:
        """Return the inserted needle, in T."""
        depth = self.depth(time)
        inside = self._shaft[self._shaft[:, 2] < depth]
        shaft = np.vstack([inside, self.position(depth)])
        return Needle(self.X_TI.multiply(shaft.T).T, OUTER_DIAMETER[self._parameters.gauge] / 2)


def _wandering(
    path: BicyclePath,
    lengths: NDArray[np.float64],
    parameters: BevelledInsertionParameters,
    rng: np.random.Generator,
) -> NDArray[np.float64]:
    """(n, 3) points of a path whose curvature wanders, stepwise, at lengths in m."""
    sigma = parameters.wander_length / _STEP
    noise = gaussian_filter1d(rng.normal(size=len(lengths) + 8 * int(sigma)), sigma)
    noise *= np.sqrt(2 * np.sqrt(np.pi) * sigma)  # to a variance of 1
    relative = 1 + parameters.curvature_wander * noise[4 * int(sigma) :]
    states = [np.array([0.0, 0.0, 0.0, path.angle, path.plane])]
    for step, factor in zip(np.diff(lengths), relative, strict=False):
        turns = int(np.searchsorted(path.rotations, states[-1][2]))
        curvature = factor * (-1) ** turns / path.radius
        # Half of the turn before the step and half after it: exact to second order.
        halfway = states[-1] + [0, 0, 0, 0.5 * step * curvature, 0]
        state = bicycle_step(halfway, step, curvature)
        states.append(state - [0, 0, 0, 0.5 * step * curvature, 0])
    return np.array(states)[:, :3]
